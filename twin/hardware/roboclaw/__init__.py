"""RoboClaw motor boards: PWM, encoders, limits and status.

- `codec`: encoding and decoding of commands and replies.
- `client`: several boards on one serial line, with deadlines.
"""
