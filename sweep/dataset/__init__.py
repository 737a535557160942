"""The labelled dataset of a study: its file, its labels, and what fills it."""
