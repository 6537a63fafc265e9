"""How a robot gets somewhere: the driving law, the local grid, ways round. Algorithms without a plug-in."""
