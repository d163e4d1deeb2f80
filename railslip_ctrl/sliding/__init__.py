"""The adaptive sliding-mode law: derived from the plant, its errata, its code, its conditions."""
