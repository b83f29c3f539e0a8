"""The dynamic KR 16: MuJoCo's forward dynamics under a servo, a plant of the simulated controller (docs/plant.md)."""
