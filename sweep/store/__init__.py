"""What is kept on disk: products under their identity, what they cost, which sources made them."""
