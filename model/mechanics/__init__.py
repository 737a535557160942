"""The grains: discs with soft contacts, packed, bonded and loaded by walls.

Stages: `packing.packing.pack`, `loading.stress.unit_loads` and `load`, `loading.strength.strength`.

`contact`: grains that touch
- `grains`: position, motion and forces of the discs; the mass that makes a time step stable
- `neighbours`: the list of pairs that may touch, with what contacts remember
- `law`: laws of contact, a file each; `laws`: scalar formulas of slip, damping, bond strength
- `bonds`, `joints`: cement between grains, and fractures along which they slide
- `batches`, `contacts`: forces at all contacts, batch by batch, and what they add up to
- `energy`: the ledger of what is put in, stored and lost

`motion`: one step, and many
- `motion`: velocities by local damping or FIRE, and positions
- `servo`: walls and a stretch that follow wanted stresses
- `bounds`: walls or a cell that repeats itself, as the loop sees them
- `equilibrium`: the loop over steps, and its drivers `Assembly` and `Specimen` (between walls)

`packing`: grains put together
- `sizes`, `lattices`: radii by a law; regular packings
- `compaction`: one packing by one recipe
- `packing_targets`: the recipe that meets a porosity, a stress or a friction
- `cell`, `tiles`: a periodic cell, and one repeated over a rectangle
- `floaters`: grains without load fitted into their voids
- `packing`: the stage

`specimen`: a rock of packed grains
- `rock`: packed grains with cement and joints, in the units below
- `cut`: parts of a specimen, holes, loads on them
- `records`: what its contacts carry and what broke
- `measures`: porosity, fabric, stress, strain, force chains of grains at rest

`static`: the static solver
- `load_carrying`: what carries load
- `stiffness`: the matrix and its factor
- `walls`, `wall_contacts`: what walls put on the grains, and which grains leave or meet them
- `displaced`, `sticking`: displaced grains by the true law, and by that of contacts that hold
- `static`: unit loads, superposed and corrected
- `moduli`: elastic moduli without walls

`loading`: the stages under load
- `stress`, `state`: states of stress, static where bonds hold, along a path else; their product
- `strength`: tests to failure

Drivers work in units of the mean radius, the normal stiffness k_n and the mass of a grain,
so that stresses are σ / k_n and the stable time step is 0.5. Statics do not feel the mass.
"""
