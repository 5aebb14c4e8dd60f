"""The hand in the image: landmarks, a metric skeleton, the fit to depth and object."""
