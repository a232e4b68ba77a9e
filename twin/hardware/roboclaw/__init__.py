"""RoboClaw motor boards: PWM, encoders, limits and status.

- `codec`: commands and answers as bytes, and back.
- `client`: several boards on one serial line, within deadlines.
"""
