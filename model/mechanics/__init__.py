"""The grains: discs with soft contacts, packed, bonded and loaded by walls.

Stages: `packing.pack`, `stress.unit_loads` and `stress.load`, `strength.strength`. The room, by
ideas:

What the kernels work on, and the laws
- `grains`: position, motion and forces of the discs; the mass that makes a time step stable
- `neighbours`: the list of pairs that may touch, with what contacts remember
- `bonds`, `joints`: cement between grains, and fractures along which they slide
- `laws`: the scalar laws of contact, slip, damping and bond strength

One step, and many
- `blocks`, `contacts`: forces at all contacts, block by block, and what they add up to
- `motion`: velocities by local damping or FIRE, and positions
- `servo`: walls and a stretch that follow wanted stresses
- `energy`: the ledger of what is put in, stored and lost
- `equilibrium`: the loop over steps, and its drivers `Assembly` and `Specimen` (between walls)
- `cell`: the same in a cell that repeats itself

Packing
- `sizes`: radii by a law
- `lattices`: regular packings
- `compaction`: one packing by one recipe
- `targets`: the recipe that meets a porosity, a stress or a friction
- `tiles`: a periodic cell repeated over a rectangle
- `floaters`: grains without load fitted into their voids
- `packing`: the stage

Rock under stress
- `rock`: packed grains with cement and joints, in the units below
- `stress`: the stages of stress states, static where bonds hold, along a path else
- `state`, `records`: their product: what contacts carry and what broke

The static solver
- `backbone`: what carries load
- `stiffness`: the matrix and its factor
- `walls`, `wall_contacts`: what walls put on the grains, and which grains leave or meet them
- `trial`, `held`: displaced grains by the true law, and by that of contacts that hold
- `static`: unit loads, superposed and corrected

Tests and measures
- `strength`: the stage of tests to failure
- `moduli`: elastic moduli without walls
- `cut`: parts of a specimen, holes, loads on them
- `measures`: porosity, fabric, stress, strain, force chains of grains at rest

Drivers work in units of the mean radius, the normal stiffness k_n and the mass of a grain,
so that stresses are σ / k_n and the stable time step is 0.5. Statics do not feel the mass.
"""
