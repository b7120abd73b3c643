"""Comparisons with published measurements that nothing was fitted to."""
