"""The geometry kernel: depth views, the alignment problem, scores, Gauss-Newton, normals."""
