"""Configurations and scripts of the published controllers."""
