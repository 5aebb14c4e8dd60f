"""Human grasps on many objects, in three parts that share no object: to train, to validate, to test."""
