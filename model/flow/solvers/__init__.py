"""Solvers of the flow equation, and the choice between them."""
