"""The simulated world: meshes, generated shapes, object sets, symmetry, rendering, sensing, pairs.

Needs the extra ``sim``: without it the import of any of its modules raises MissingExtra.
"""

from reorient.extras import require

require("trimesh")
