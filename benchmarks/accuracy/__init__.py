"""How far methods and bodies are from reference solutions, beside what they cost."""
