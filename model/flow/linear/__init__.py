"""Linear algebra of the flow equation: graphs, orders of elimination, subtraction-free factors."""
