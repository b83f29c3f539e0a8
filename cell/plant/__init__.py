"""The dynamic arm: MuJoCo's forward dynamics under a servo, a plant of the simulated controller (docs/plant.md)."""
