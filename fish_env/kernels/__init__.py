"""Compilation: vector notation for kernels, their compiler, cache and threads; GPUs."""
