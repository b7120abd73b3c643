"""The same kernels on an NVIDIA GPU, one fish per thread: compiled by numba-cuda, which is imported only on request.

`compiling` compiles kernels to PTX, `memory` copies packs to a GPU; `fish_env.envs.launch` is an environment step of
every fish as one launch.
"""
