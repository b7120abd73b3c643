"""Elastic objects after Song (2009)."""
