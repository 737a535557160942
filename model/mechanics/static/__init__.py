"""The static solver: what carries load, its stiffness and factor, and superposed unit loads."""
