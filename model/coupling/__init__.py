"""What only coupling knows: how fluid pushes grains, and how grains squeeze their pores.

- `duality`: one matrix for both
- `frame`: the stiffness of the bonded grains between walls
- `rock`: the linear poroelastic equations of a frame and its pores
- `record`: what is recorded of it
- `krylov`, `march`: its transients, by projection and step by step
- `consolidation`: the stage, responses to a unit of each source
"""
