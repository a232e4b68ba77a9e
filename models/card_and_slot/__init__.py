"""The computer card and the slot that it is inserted into (thesis chapter 5).

- `build`: card and slot of any width, and a bench with a compliant hand.
- `stand`: card in a rover's gripper, slot on its post.
"""
