"""Rovers of other shapes, written as the MJCF files that a user would bring."""

from pathlib import Path
from xml.etree import ElementTree

import mujoco

from models.compose import FOLDER

STALL, NO_LOAD = 4.0, 8.0


def six_wheels(folder: Path) -> str:
    """The rover without its arm and with a third pair of wheels, which have motors of their own."""
    rover = mujoco.MjSpec.from_file(str(FOLDER / "rover" / "rover.xml"))
    for key in list(rover.keys):
        rover.delete(key)  # it has fewer wheels
    for side, x in (("left", -0.14), ("right", 0.14)):
        name = f"middle_{side}"
        wheel = rover.body("chassis").add_body(name=f"{name}_wheel", pos=[x, 0.0, -0.015299])
        wheel.add_joint(name=f"{name}_joint", axis=[-1, 0, 0], armature=0.01)
        wheel.add_geom(
            name=f"{name}_tyre", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.0487, 0.02, 0.0],
            quat=[0.7071068, 0.0, 0.7071068, 0.0], mass=0.2, group=3,
        )  # fmt: skip
        motor = rover.add_actuator(
            name=name, target=f"{name}_joint", trntype=mujoco.mjtTrn.mjTRN_JOINT,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE, ctrllimited=True, ctrlrange=[-12, 12],
        )  # fmt: skip
        motor.gainprm[0], motor.biasprm[2] = STALL / 12.0, -STALL / NO_LOAD
        rover.add_sensor(
            name=f"{name}_vel", type=mujoco.mjtSensor.mjSENS_JOINTVEL, objname=f"{name}_joint",
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
        )  # fmt: skip
    rover.compile()
    path = folder / "six_wheels.xml"
    path.write_text(rover.to_xml())
    return str(path)


def six_joints(folder: Path) -> str:
    """The rover with an arm of six joints: two more between wrist and hand."""
    rover, arm = (ElementTree.parse(FOLDER / part / f"{part}.xml") for part in ("rover", "arm"))
    root, other = rover.getroot(), arm.getroot()
    mount = root.find(".//site[@name='attachment_site']").get("pos")
    base = other.find(".//body[@name='arm_base_link']")
    base.set("pos", mount)
    root.find(".//body[@name='chassis']").append(base)
    for section in ("default", "asset", "contact", "actuator", "sensor"):
        if root.find(section) is None:
            ElementTree.SubElement(root, section)
        root.find(section).extend(other.find(section))
    parent = base.find(".//body[@name='wrist']")
    for name, axis in (("roll", "0 1 0"), ("hand", "1 0 0")):
        parent.append(
            ElementTree.fromstring(f"""
            <body name="{name}" pos="0 0.06 0">
              <joint name="{name}_joint" axis="{axis}" range="-1.5 1.5"/>
              <geom class="arm_visual" size="0.01" mass="0.02"/>
            </body>""")
        )
        parent = parent[-1]
        motor = f'<dcmotor name="{name}" class="arm" joint="{name}_joint"/>'
        root.find("actuator").append(ElementTree.fromstring(motor))
        for kind in ("pos", "vel"):
            sensor = f'<joint{kind} name="{name}_{kind}" joint="{name}_joint"/>'
            root.find("sensor").append(ElementTree.fromstring(sensor))
    root.remove(root.find("keyframe"))
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    for name, angle in (("shoulder", 0.9), ("elbow", -1.4), ("hand", 0.3)):
        data.joint(f"{name}_joint").qpos = angle
    mujoco.mj_forward(model, data)
    for motor in map(model.actuator, range(4, model.nu)):  # the wheels' come first
        resistance, constant = motor.gainprm[:2]
        load = data.qfrc_bias[model.jnt_dofadr[motor.trnid[0]]]
        data.ctrl[motor.id] = load * resistance / constant
    qpos, ctrl = (" ".join(map(str, numbers)) for numbers in (data.qpos, data.ctrl))
    keys = ElementTree.SubElement(root, "keyframe")
    ElementTree.SubElement(keys, "key", name="home", qpos=qpos, ctrl=ctrl)
    path = folder / "six_joints.xml"
    rover.write(path)
    return str(path)
