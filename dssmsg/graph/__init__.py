"""The scene graph and the paper's pure algorithms."""
