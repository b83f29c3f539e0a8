"""Examination of the methods: accuracy against speed, and limits of validity."""
