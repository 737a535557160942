"""Stages that load a rock: to a state of stress, or to failure."""
