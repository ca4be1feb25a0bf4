"""The simulated world: meshes, generated shapes, object sets, symmetry, rendering, sensing, pairs."""
