"""Design models: the models of the plant that estimators and controllers use."""
