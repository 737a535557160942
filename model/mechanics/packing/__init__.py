"""Grains put together: sizes, compaction to a porosity or a stress, floaters, tiles."""
