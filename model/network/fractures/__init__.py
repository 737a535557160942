"""Fractures on the network: where their lines run, how wide they are, and what meets them."""
