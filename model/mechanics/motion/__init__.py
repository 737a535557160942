"""Grains that move: one step, walls that follow stresses, and the loop to equilibrium."""
