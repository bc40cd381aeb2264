"""The reconstruction by Gaussians: model, objective, steps, and the settings that steer them."""
