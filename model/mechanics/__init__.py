"""The grains: discs with soft contacts, packed, bonded and loaded by walls.

Stages: `packing.pack` (with `lattices`) and `stress.load`. Underneath, from the formula to
the loop:

- `laws`: the scalar laws of contact, slip, damping and bond strength;
- `grains`, `neighbours`, `bonds`: what the kernels work on, and how it is made;
- `contacts`, `motion`, `servo`: one step, kernel by kernel;
- `equilibrium`: the loop over steps and `Specimen`, the driver that both stages use;
- `measures`: porosity and contacts of grains at rest.

Drivers work in units of the mean radius, the normal stiffness k_n and the mass of a grain,
so that stresses are σ / k_n and the stable time step is 0.5. Statics do not feel the mass.
"""
