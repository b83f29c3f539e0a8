"""The arm: the KR 16's model file or another's brought into its form, closed-form kinematics, KUKA frames."""
