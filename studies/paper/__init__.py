"""Daney (1998), sections 4 and 5: the Monte-Carlo of the paper at its full size."""
