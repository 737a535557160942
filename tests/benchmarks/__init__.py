"""Measured claims: each module is one check, named for what it shows."""
