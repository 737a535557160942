"""The labelled dataset of a study: its file, its labels, and what fills it."""

STUDY_FILE, DATASET_FILE = "study.yaml", "dataset.nc"  # in results/<study>/
