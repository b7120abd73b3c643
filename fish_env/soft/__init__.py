"""Elastic objects beside the core: they use its tables and extension points, and the core does not import them.

- The layered objects of Song, strings, rings and spheres with gas, and solid ones (`objects`, `solids`, `detail`), in a
  room (`room`), with their forces in `forces`.
- Tetrahedral finite elements (`mesh`, `elements`), their equilibria (`statics`), and the fish made of them
  (`tetrahedral`) or of two skins with gas (`two_layer`).
- Boundary conditions (`conditions`), adaptive methods (`adaptive`) and bodies that follow a midline (`midline`).
"""
