"""Studies of Optuna: what is searched, where it is kept, and the workers that bring it to its end."""
