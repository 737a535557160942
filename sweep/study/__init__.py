"""From the text of a study to its cases, checked."""
