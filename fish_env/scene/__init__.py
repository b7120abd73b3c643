"""How bodies look, without anything that draws: the window, the film and the laboratory draw the same records."""
