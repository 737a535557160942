"""The flow equation C dp/dt = -G p + q on the pores: sites, wells, outputs, balance."""
