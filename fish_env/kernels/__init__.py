"""Compilation: vector notation for kernels, how they are compiled, stored and shared out over threads; GPUs."""
