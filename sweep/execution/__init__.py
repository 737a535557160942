"""Stage runs handed to workers, and what becomes of them."""
