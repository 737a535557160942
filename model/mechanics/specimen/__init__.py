"""A rock made of packed grains: its bonds and joints, parts cut from it, what is measured in it."""
