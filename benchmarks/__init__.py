"""Time and error of the simulator, the operators and the reconstructions, and the numbers of the documents."""
