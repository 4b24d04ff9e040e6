"""How long things take, as ratios against a peer that is measured in the same run, on one thread."""
