"""What runs: the stages' identities and the graph of distinct stage runs."""
