"""The same kernels on an NVIDIA GPU, one fish per thread: compiled by numba-cuda, which is imported only on request.

`compiling` compiles kernels, `memory` copies packs to a GPU; `launch` is an environment step of every fish as
one launch, and `torch_env` a batch of fish in torch tensors.
"""
