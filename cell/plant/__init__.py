"""The dynamic arm: MuJoCo's forward dynamics under a servo, a plant of the controller (docs/internals/plant.md)."""
