"""Lightning modules for the trainings, and the data they read: every batch is a function of the seed and the step."""
