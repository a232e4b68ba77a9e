"""Pictures and recordings of a card's insertion, for ``ch5-insertion`` and ``mission``."""

import rerun.blueprint as rrb

from controllers.insertion.card_inserter import CardInserter
from experiments.ch5.insertion_scene import SLAVE
from perception.geometry.arrays import ImageArray
from twin.camera import renderer
from twin.recording.record import Recorder
from twin.simulation import Simulation

SIZE = (640, 480)


def scene_picture(simulation: Simulation, camera: str) -> ImageArray:
    """Return a colour picture of the scene as it is now.

    Args:
        simulation: Simulation of the scene.
        camera: Name of the camera.
    """
    return renderer().render(simulation.model, simulation.data, camera, *SIZE).copy()


def insertion_views(task: str) -> list[rrb.View]:
    """Return the viewer's views of what `InsertionLog` adds to a recording.

    Args:
        task: Entity path of the task.
    """
    return [
        rrb.TimeSeriesView(origin=f"{task}/contact", name="Contact as felt"),
        rrb.TimeSeriesView(origin=f"{SLAVE}/sensors/arm_base_wrench", name="Wrench"),
        rrb.TextLogView(origin=f"{task}/stage", name="Stage"),
    ]


class InsertionLog:
    """Adds contact and stage of an insertion to a recording.

    Args:
        recorder: Recording of the robots.
        task: Entity path of the task.
    """

    def __init__(self, recorder: Recorder, task: str) -> None:
        self._recorder, self._task, self._text = recorder, task, ""

    def add(self, inserter: CardInserter | None, *words: str) -> None:
        """Log this tick's contact, and the stage where it has changed.

        Args:
            inserter: The slave; None before it has begun.
            words: Description of the stage, in parts; an empty one is left out.
        """
        if inserter is not None:
            names = ("across [N]", "ahead [N]", "moment [N m]")
            contact = inserter.contact[[0, 1, 5]]
            self._recorder.log_scalars(f"{self._task}/contact", contact, names)
            words += (inserter.stage.value, inserter.reason)
        text = " ".join(word for word in words if word)
        if text != self._text:
            self._text = text
            self._recorder.log_text(f"{self._task}/stage", text)
