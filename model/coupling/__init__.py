"""What only coupling knows: how fluid pushes grains, and how grains squeeze their pores.

- `duality`: one matrix for both
- `frame`: the stiffness of the bonded grains between walls
- `rock`: the linear poroelastic equations of a frame and its pores
- `record`: what is recorded of it
- `krylov`, `march`: its transients, by projection and step by step
- `following`: the stage *follow*, a march with apertures that follow the forces on them
- `consolidation`: the stage *consolidate*, responses to a unit of each source
- `skeleton`: contacts that slide, part and break, in small displacements
- `matrix`, `balance`: one implicit step of rock and fluid together
- `setting`: what a march through breaking bonds starts from
- `breaking`: the march, from bond to bond
- `told`, `fracture`: the stage, leg by leg, and what it records
"""
