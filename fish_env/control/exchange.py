"""Policies for other programs: models in ONNX and TorchScript, made of the parts of a policy file.

onnx is loaded only here, and torch only here and in `equivariant`, when a file is written or read.
"""

import importlib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fish_env.control.files import replacing

OPSET, IR = 17, 8  # versions of ONNX's operators and of its files: those of 2022, which every runtime in use reads
LAYERS = {"tanh": "Tanh", "relu": "Relu"}  # operators of the hidden activations


def load_onnx() -> Any:
    """The library, or ImportError that says how to install it."""
    try:
        return importlib.import_module("onnx")
    except ImportError as error:
        raise ImportError('ONNX files need onnx: pip install "fish_env[onnx]"') from error


def arrays_of(parts: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], int]:
    """The arrays among the parts of a policy, and its number of layers, which are float32; the rest is float64."""
    arrays = {name: np.asarray(part) for name, part in parts.items() if isinstance(part, np.ndarray | float)}
    layered = ("weight", "bias")
    arrays = {n: array.astype(np.float32 if n.startswith(layered) else np.float64) for n, array in arrays.items()}
    return arrays, sum(name.startswith("weight") for name in arrays)


def onnx_model(parts: Mapping[str, Any]) -> Any:
    """The ONNX model of a policy: arrays are its initializers, under their names; the rest is its metadata."""
    onnx = load_onnx()
    make, types = onnx.helper, onnx.TensorProto
    arrays, count = arrays_of(parts)
    nodes, last = [], "observation"

    def then(kind: str, *inputs: str, **options) -> None:
        nonlocal last
        nodes.append(make.make_node(kind, [last, *inputs], [last := f"value{len(nodes)}"], **options))

    if "mean" in arrays:
        nodes.append(make.make_node("Neg", ["limit"], ["least"]))
        then("Cast", to=types.DOUBLE)
        then("Sub", "mean")
        then("Div", "deviation")
        then("Clip", "least", "limit")
        then("Cast", to=types.FLOAT)
    for k in range(count):
        then("Gemm", f"weight{k}", f"bias{k}")
        if k < count - 1:
            then(LAYERS[parts["hidden"]])
    if parts["output"] == "clip":
        for name, bound in (("lowest", -1.0), ("highest", 1.0)):
            nodes.append(make.make_node("Constant", [], [name], value_float=bound))
        then("Clip", "lowest", "highest")
    else:
        then("Tanh")
    nodes[-1].output[0] = "action"
    sizes = {"observation": arrays["weight0"].shape[0], "action": arrays[f"weight{count - 1}"].shape[1]}
    ends = [[make.make_tensor_value_info(n, types.FLOAT, ["batch", size])] for n, size in sizes.items()]
    tensors = [onnx.numpy_helper.from_array(array, name) for name, array in arrays.items()]
    graph = make.make_graph(nodes, "policy", *ends, tensors)
    model = make.make_model(
        graph, opset_imports=[make.make_opsetid("", OPSET)], ir_version=IR, producer_name="fish_env"
    )
    make.set_model_props(model, {name: str(part) for name, part in parts.items() if name not in arrays})
    return model


def write_onnx(parts: Mapping[str, Any], path: Path) -> None:
    """Write the parts of a policy as an ONNX model, whole or not at all."""
    model = onnx_model(parts)
    load_onnx().checker.check_model(model, full_check=True)
    with replacing(path) as partial:
        partial.write_bytes(model.SerializeToString())


def read_onnx(path: Path) -> tuple[dict[str, Any], Any]:
    """The parts of a policy that `write_onnx` wrote, and its graph; ImportError without onnx, ValueError for others."""
    onnx = load_onnx()
    try:
        model = onnx.load_model_from_string(path.read_bytes())
        if any(part.data_location for part in model.graph.initializer):
            raise ValueError("its numbers are in other files")
        arrays = {part.name: onnx.numpy_helper.to_array(part) for part in model.graph.initializer}
        words: dict[str, Any] = {part.key: part.value for part in model.metadata_props}
        words |= {name: int(words[name]) for name in ("format", "layout")}
    except Exception as error:  # what is damaged may raise anything
        reason = (str(error).splitlines() or [""])[0]
        raise ValueError(f"{path} is not a policy file that Policy.to_onnx wrote ({reason:.200})") from error
    return words | {name: part if part.ndim else part.item() for name, part in arrays.items()}, model.graph


def write_torchscript(parts: Mapping[str, Any], path: Path) -> None:
    """Write the parts of a policy as a TorchScript module, whole or not at all."""
    try:
        import torch
        from torch import nn
    except ImportError as error:
        raise ImportError('TorchScript files need torch: pip install "fish_env[train]"') from error

    class Normalise(nn.Module):
        """As `Normalisation`."""

        def __init__(self, mean, deviation, limit):
            super().__init__()
            self.register_buffer("mean", torch.from_numpy(mean))
            self.register_buffer("deviation", torch.from_numpy(deviation))
            self.limit = float(limit)

        def forward(self, obs):
            return ((obs.double() - self.mean) / self.deviation).clamp(-self.limit, self.limit).float()

    arrays, count = arrays_of(parts)
    modules: list[nn.Module] = []
    if "mean" in arrays:
        modules.append(Normalise(arrays["mean"], arrays["deviation"], arrays["limit"]))
    for k in range(count):
        weight, bias = (torch.from_numpy(arrays[f"{kind}{k}"].copy()) for kind in ("weight", "bias"))
        modules.append(nn.utils.skip_init(nn.Linear, *weight.shape))  # draws no random numbers
        modules[-1].load_state_dict({"weight": weight.T, "bias": bias})
        modules.append(nn.Tanh() if parts["hidden"] == "tanh" else nn.ReLU())
    modules[-1] = nn.Hardtanh() if parts["output"] == "clip" else nn.Tanh()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # torch advises its newer formats, which need torch to run
        policy = nn.Sequential(*modules).requires_grad_(False)  # what it gives is read as plain numbers
        made: Any = torch.jit.trace(policy, torch.zeros(1, len(arrays["weight0"])))
    with replacing(path) as partial:
        partial.write_bytes(made.save_to_buffer())  # torch ends the process where its own write fails
