"""Models fitted to measured tests: reservoir models, and the network of a scene."""
