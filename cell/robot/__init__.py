"""The KR 16: its model file, closed-form kinematics, KUKA frames."""
