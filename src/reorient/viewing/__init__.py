"""What other programs and browsers show live: recordings as MCAP, and the 3D viewer."""
