"""Learning: pair store, batches, networks, losses, training, export, training of the verifier."""
