"""What is read from a dataset: flow regimes, permeabilities, comparisons with formulas."""
