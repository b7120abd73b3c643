"""Forces of soft objects, walls and anchors; `fish_env.physics.forces` has their contract and their table."""
