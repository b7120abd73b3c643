"""What steps, environments and processes cost."""
