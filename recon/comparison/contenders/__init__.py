"""What takes part and how it runs against the clock, with the models along its way."""
