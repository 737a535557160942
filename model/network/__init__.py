"""The pores: domains and pipes of the contact graph, their apertures, and fractures."""
