"""The same kernels on an NVIDIA GPU, a fish a thread: compiled by numba-cuda, which is imported only on request.

`compiling` makes PTX of kernels, `memory` puts packs where a GPU finds them; `fish_env.envs.launch` is an environment
step of every fish as one launch.
"""
