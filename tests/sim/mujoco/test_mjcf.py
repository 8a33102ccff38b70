"""Objects weigh what robosuite's do."""

from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from jaxcam.sim.mujoco.mjcf import robosuite_object
from jaxcam.sim.tasks import square
from jaxcam.sim.tasks.pick_place_can import PickPlaceCan
from jaxcam.sim.tasks.square import Square


def test_physics_has_robosuites_masses():
    """The can's and the nut's are those of robosuite's models, the peg's that of the cylinder."""
    for name, task in (("can_main", PickPlaceCan()), ("nut_main", Square())):
        model = mujoco.MjModel.from_xml_string(alone(robosuite_object(task.objects()[0])))
        physics = task.scene("fixed").physics
        body = physics.body(name)
        np.testing.assert_allclose(body.mass[0], model.body(name).mass[0], rtol=1e-5)
        np.testing.assert_allclose(body.inertia, model.body(name).inertia, rtol=1e-5)
    volume = np.pi * square.PEG_RADIUS**2 * 2 * square.PEG_HALF_LENGTH
    volume += 8 * np.prod(square.BASE_HALF_SIZE)
    peg = Square().scene("fixed").physics.body("peg_root")
    np.testing.assert_allclose(peg.mass[0], square.DENSITY * volume, rtol=1e-5)


def alone(thing):
    """The MJCF of one robosuite object by itself."""
    root = ET.Element("mujoco")
    root.append(thing.asset)
    body = ET.SubElement(root, "worldbody")
    body.append(thing.get_obj())
    return ET.tostring(root, encoding="unicode")
