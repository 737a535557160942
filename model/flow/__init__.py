"""The fluid: the flow equation on the network of pores, and its solvers."""
