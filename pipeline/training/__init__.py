"""Training of the networks on a grid."""
