"""Grains that touch: pairs, laws of contact, bonds and joints, and what they store."""
