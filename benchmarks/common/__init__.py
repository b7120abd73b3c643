"""What the benchmarks share: tables, charts, timing, scenes, bodies. It imports no benchmark."""
