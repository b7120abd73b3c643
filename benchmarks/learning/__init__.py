"""What training reaches, what its choices are worth, and how policies perform."""
