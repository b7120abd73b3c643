"""What each level of water, none, drag alone or inertia too, gives a scene and costs."""
