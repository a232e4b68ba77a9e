"""Any MuJoCo model as something that predicts: parameters by name, and what its sensors would read.

In reading order:

- `parameters`: what can be identified of a model, by name; written back into the model.
- `limits`: what a robot may do in a motion, and whether a motion keeps to it.
- `predictor`: a model driven by the commands of logs, for many values of its parameters at once.
"""
