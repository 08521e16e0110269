"""Every picture: the command line, TensorBoard and reports call these."""
