"""The reconstruction by Gaussians: model, likelihood, optimization, and the numbers that steer it."""
