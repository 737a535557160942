"""What only coupling knows: how fluid pushes grains, and how grains squeeze their pores.

- `duality`: one matrix for both
"""
