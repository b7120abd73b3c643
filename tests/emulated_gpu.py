"""Code for a GPU run on the processor, thread by thread: the program for NVVM, compiled by LLVM instead.

Only NVVM and the hardware are left out. The threads run one after another, so what they would do to each other at
the same time is not seen.
"""

import ctypes
import re
from contextlib import contextmanager
from functools import cache
from types import SimpleNamespace
from unittest.mock import patch

import llvmlite.binding as llvm
import numpy as np

from fish_env.gpu.compiling import exactly
from fish_env.gpu.launch import SIGNATURE, launch_for, threads_pack
from fish_env.gpu.memory import Upload
from fish_env.kernels.simd.types import WARP

POINTERS = (r"(?:\bi\d+|\bdouble|\bfloat|\bptr)\*", r"\{[^{}]*\}\*", r"\[[^\[\]]*\]\*")
REGISTERS = ("tid", "ntid", "ctaid", "nctaid")
TESTS = {"isfinited": "ord double %b, %b", "isnand": "uno double %a, %a"}
"""Functions of NVIDIA's mathematical library that the C library has not, as comparisons of %a and %b = %a - %a."""


def to_ptx(function, signature, cc):
    """PTX of a plain function with a signature, for a compute capability such as (9, 0); no GPU is needed."""
    device = SimpleNamespace(compute_capability=cc)
    with exactly() as cuda, patch("numba.cuda.dispatcher.get_current_device", lambda: device):
        return cuda.compile_ptx(function, signature, cc=cc)[0]


@contextmanager
def program():
    """A list that is filled with the modules that NVVM is given meanwhile."""
    from numba.cuda.cudadrv import nvvm

    found, compile_ir = [], nvvm.compile_ir

    def noting(modules, **options):
        found[:] = modules
        return compile_ir(modules, **options)

    nvvm.compile_ir = noting
    try:
        yield found
    finally:
        nvvm.compile_ir = compile_ir


def for_processor(text, machine):
    """A module of NVVM's language for this processor: untyped pointers, the C library, registers as variables."""
    text = re.sub("target triple = .*", f'target triple = "{llvm.get_process_triple()}"', text)
    text = re.sub("target datalayout = .*", f'target datalayout = "{machine.target_data}"', text)
    before = None
    while text != before:
        before = text
        for pattern in POINTERS:
            text = re.sub(pattern, "ptr", text)
    text = re.sub(r'@"__nv_(\w+)"', r'@"\1"', text)
    for name, comparison in TESTS.items():
        body = f"%b = fsub double %a, %a\n %c = fcmp {comparison}\n %d = zext i1 %c to i32\n ret i32 %d"
        text = re.sub(
            rf'declare i32 @"{name}"\(.*\)', f'define linkonce_odr i32 @"{name}"(double %a) {{ {body} }}', text
        )
    for name in REGISTERS:
        reader = f'@"llvm.nvvm.read.ptx.sreg.{name}.x"'
        body = f"%a = load i32, ptr @the_{name}\n ret i32 %a"
        own = f"@the_{name} = linkonce_odr global i32 0\ndefine linkonce_odr i32 @read_{name}() {{ {body} }}"
        text = text.replace(f"declare i32 {reader}()", own).replace(reader, f"@read_{name}")
    return re.sub("^!nvvm.*$", "", text, flags=re.MULTILINE)


class Emulated:
    """A kernel `name` for a GPU, a program of modules, run on this processor: `emulated(*arguments)`."""

    def __init__(self, modules, name, types):
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        machine = llvm.Target.from_default_triple().create_target_machine(opt=1)
        first, *others = (llvm.parse_assembly(for_processor(text, machine)) for text in modules)
        for each in others:
            first.link_in(each)
        first.verify()
        defined = [each.name for each in first.functions if not each.is_declaration]
        (entry,) = (each for each in defined if f"_3e{len(name)}{name}B" in each)
        self._engine = llvm.create_mcjit_compiler(first, machine)
        self._engine.finalize_object()
        self._call = ctypes.CFUNCTYPE(None, *types)(self._engine.get_function_address(entry))
        self._registers = [
            ctypes.c_int32.from_address(self._engine.get_global_value_address(f"the_{register}"))
            for register in REGISTERS
        ]

    def __call__(self, warps, *arguments):
        """Run as many blocks of one warp each."""
        tid, ntid, ctaid, nctaid = self._registers
        ntid.value, nctaid.value = WARP, warps
        for ctaid.value in range(warps):
            for tid.value in range(WARP):
                self._call(*arguments)


@cache
def emulated(launch, cc=(9, 0)):
    """A kernel of `launch_for`, emulated, and its PTX."""
    with program() as modules:
        ptx = to_ptx(launch, SIGNATURE, cc)
    return Emulated(modules, "launch", [ctypes.c_int64] * 3 + [ctypes.c_double]), ptx


def emulated_launcher(episodes, env_type, blocks, device):
    """In place of `fish_env.gpu.torch_env.launcher`."""
    from fish_env.gpu.torch_env import BLOCK

    call, _ = emulated(launch_for(episodes, env_type))
    return lambda *arguments: call(blocks * BLOCK, *arguments)


class EmulatedSteps:
    """The fish of an environment in a GPU that is emulated, from where they are now.

    Args:
        env: whose arrays are copied.
        warps: that run at once; None for a thread a fish.
        cc: compute capability.
    """

    def __init__(self, env, warps=None, cc=(9, 0)):
        self.env, self.warps = env, -(-env.num_envs // WARP) if warps is None else warps
        self.pack = threads_pack(env)
        self.upload = Upload(self.pack, self.warps, placed, lambda array: array.ctypes.data)
        self._launch, self.ptx = emulated(launch_for(env, self.upload.type), cc)

    def step(self, action):
        """One control interval of all fish."""
        self.upload.of(self.env._arrays["action"])[...] = action
        self._launch(self.warps, self.upload.address, self.env.num_envs, self.env._substeps, self.env.control_interval)


def placed(what, dtype=None):
    """A copy of an array, or zeros of a shape and type."""
    return np.array(what, order="C") if dtype is None else np.zeros(what, dtype)
