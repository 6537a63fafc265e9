"""The furniture recogniser: what it is trained on, what its networks are shown, and how masks come of it."""
