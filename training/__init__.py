"""Seeds to weights: `python -m training STAGE`; see training/README.md. Not part of the wheel."""
