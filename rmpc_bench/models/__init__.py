"""What an estimator or a controller believes of the plant."""
