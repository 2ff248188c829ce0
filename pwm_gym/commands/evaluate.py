"""``pwm-gym evaluate``."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pwm_gym.commands.crew import crew
from pwm_gym.commands.failures import draw_failures
from pwm_gym.commands.folders import data_folder
from pwm_gym.commands.numbers import check_least

if TYPE_CHECKING:
    from pwm_gym.cameras import DepthCamera
    from pwm_gym.data import Dataset, Episode
    from pwm_gym.dynamics import WorldModel
    from pwm_gym.perception import RenderedObserver
    from pwm_gym.scene import RigidState, Scene
    from pwm_gym.tasks import Task

__all__ = ["Evaluate"]

_WITHOUT_LEARNING = ("still", "commanded", "linear")


@dataclass(frozen=True)
class Evaluate:
    """Roll a checkpoint out on a data set's test split, beside baselines, an oracle end effector and floors.

    A model that was trained on partial clouds starts from such ones, and is measured in rollouts alone.
    With ``--table``, train and evaluate every row of one of the paper's tables instead; what is there already is kept.
    """

    task: str = "PickCube"
    """Registered task."""
    data: Path | None = None
    """Folder of a data set. None takes ``data-sets/`` and the task's name."""
    fit_data: Path | None = None
    """Folder of a data set on whose training split the baselines without learning are fitted: the checkpoint's own,
    where ``data`` has objects that were kept out of training. None takes ``data``."""
    checkpoint: str = "default"
    """A folder or a shipped checkpoint's name."""
    split: str = "test"
    """Which split."""
    every: int = 1
    """Chamfer distances are measured at each n-th step; all other metrics at every one."""
    completer: str | None = None
    """Rows that start from completed views instead of the truth: a completion checkpoint, "default" or "hull"."""
    sensor: str = "ideal"
    """Sensor model of those views: ideal or d455."""
    floors: bool = True
    """Whether to measure the floors, which needs the simulator."""
    long: int = 0
    """Episodes of 300 steps of expert and random actions in turn, made in the simulator, for long rollouts."""
    pictures: Path | None = None
    """Folder for pictures (PNG): expected against real errors, and the errors of the long rollouts over time; of tables
    of planning, the failed episodes."""
    strips: Path | None = None
    """Folder for a strip (PNG) of a rollout of each kind: predicted over true at five instants."""
    table: str | None = None
    """rollout, baselines, register, register-points, horizon, horizon-points, data, data-points, head, arm, planning,
    planning-paper, planners, completed, shared or distractors."""
    checkpoints: tuple[Path, ...] = ()
    """Table "shared": folders of checkpoints, each a row."""
    tasks: tuple[str, ...] = ()
    """Table "shared": its columns; none given takes ``--task``. Each task's data set is the one in ``data-sets/``."""
    objects: str = ""
    """Tables that plan: what episodes draw their objects from, where they differ: one of the task's sets, such as
    "unseen", or an object's name; the task's default if not given."""
    episodes: int = 50
    """Tables "shared" and "distractors": episodes."""
    full: bool = False
    """Tables of planning: whether the fast models plan 100 episodes instead of 20."""
    members: tuple[str, ...] = ()
    """Tables of trainings and of planning: only these of its rows, by name; none given takes all."""
    modes: tuple[str, ...] = ()
    """Tables of planning: only these modes, by name, such as "closed loop"; none given takes all."""
    scale: float = 1.0
    """Share of a table's training steps that each of its rows takes."""
    seeds: int = 0
    """Tables of trainings: how many of each row's seeds are trained; 0 takes all."""
    out: Path = Path("runs/tables")
    """Folder of a table's trainings and results."""
    workers: int = 1
    """Trainings of a table at once, each on one thread."""
    ray: str | None = None
    """Ray cluster whose machines make a table instead: "auto", "local" or HOST:PORT (the extra "ray")."""
    json: Path | None = None
    """Where to write the results."""
    threads: int = 2
    """PyTorch threads."""

    def run(self) -> None:
        """Print the table and write the results."""
        self._check()
        if self.table is not None:
            self._table(self.table)
            return
        from pwm_gym.data import load_split
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.evaluation import evaluate_rollouts, long_rollouts, write_results
        from pwm_gym.evaluation.report import onsets_by_split
        from pwm_gym.evaluation.text import report_text
        from pwm_gym.process import prepare_process
        from pwm_gym.tasks import get_task
        from pwm_gym.training import fit_baseline

        prepare_process(self.threads)
        if self.pictures is not None:
            self.pictures.mkdir(parents=True, exist_ok=True)
        task = get_task(self.task)
        data = data_folder(task.name, self.data)
        dataset = load_split(data, self.split, task.name)
        checkpoint = load_checkpoint(resolve(self.checkpoint, task.name))
        checkpoint.check_joints(task.layout)
        training = load_split(self.fit_data or data, "train", task.name)
        baselines = {name: fit_baseline(name, training) for name in _WITHOUT_LEARNING}
        models: dict[str, WorldModel] = {checkpoint.kind: checkpoint.model, **baselines}
        if checkpoint.description["training"].get("data", {}).get("view") == "partial":
            self._partial(models, task, dataset, data)
            return
        starts = {} if self.completer is None else _completed_starts(task, dataset, self.completer, self.sensor)
        floors = self._floors(task, dataset) if self.floors else {}
        rows = {k: evaluate_rollouts(model, task, dataset, every=self.every) for k, model in models.items()}
        rows["oracle effector"] = evaluate_rollouts(checkpoint.model, task, dataset, oracle=True, every=self.every)
        for view, start in starts.items():
            rows[f"completed, {view}"] = evaluate_rollouts(
                checkpoint.model, task, dataset, every=self.every, start=start
            )
        onsets = {k: onsets_by_split(model, dataset) for k, model in models.items()}
        print(report_text(task, rows, onsets, floors))
        self._calibration(task, rows[checkpoint.kind])
        self._strips(task, checkpoint.model, dataset)
        long = long_rollouts(checkpoint.model, dataset)
        print(f"300 zero actions, moved at the end (mm): {long['zero_actions_mm']}")
        print(f"300 random actions: farthest {long['random_actions_m']:.2f} m, finite: {long['finite']}")
        curves = self._long(task, checkpoint.model, dataset) if self.long else {}
        if self.json is not None:
            results = {
                "split": self.split,
                "every": self.every,
                "checkpoint": checkpoint.description["training"].get("data"),
                "fitted_on": str(self.fit_data or data),
                "objects": list(task.objects),
                "rows": rows,
                "onsets": onsets,
                "floors": floors,
                "long_rollouts": {**long, "mixed_actions": curves},
            }
            write_results(self.json, results)

    def _partial(self, models: dict[str, WorldModel], task: Task, dataset: Dataset, data: Path) -> None:
        """Rollouts alone of a model of partial clouds, the first of ``models``, from what the default camera sees.

        Raises:
            PwmGymError: something else is asked for.
        """
        from pwm_gym.data.partial import visible_split
        from pwm_gym.errors import PwmGymError
        from pwm_gym.evaluation import evaluate_rollouts, write_results
        from pwm_gym.evaluation.rollouts import observed_start
        from pwm_gym.evaluation.text import report_text

        for name in ("completer", "long", "pictures", "strips"):
            if value := getattr(self, name):
                raise PwmGymError(f"--{name} {value}; a model of partial clouds is measured in rollouts alone")
        start = observed_start(dataset, visible_split(data, self.split, task, dataset))
        rows = {
            kind: evaluate_rollouts(model, task, dataset, every=self.every, start=None if k else start)
            for k, (kind, model) in enumerate(models.items())
        }
        print(report_text(task, rows, {}, {}))
        if self.json is not None:
            write_results(self.json, {"split": self.split, "every": self.every, "view": "partial", "rows": rows})

    def _check(self) -> None:
        """Refuse numbers that cannot be, and options that nothing would read."""
        from pwm_gym.errors import PwmGymError

        check_least(self, every=1, workers=1, threads=1, episodes=0, long=0, seeds=0)
        if not 0 < self.scale <= 1:
            raise PwmGymError(f"--scale {self.scale}; expected a share above 0 and up to 1")
        if self.table is None and self.objects:
            raise PwmGymError(
                f"--objects {self.objects}; expected a --table that plans: a data set has its own objects"
            )
        if self.table == "distractors":
            check_least(self, episodes=1)
        if self.table == "distractors" and self.objects:
            raise PwmGymError(
                f"--objects {self.objects}; the table 'distractors' has the objects of the checkpoint's scenes"
            )
        if self.table is not None and self.fit_data is not None:
            raise PwmGymError(f"--fit-data {self.fit_data}; a table's baselines are fitted on --data")

    def _strips(self, task: Task, model: WorldModel, dataset: Dataset) -> None:
        """Draw the first episode of each kind where it is asked for."""
        if self.strips is None:
            return
        from pwm_gym.viewer.strips import draw_rollout_strips

        self.strips.mkdir(parents=True, exist_ok=True)
        path = self.strips / f"{task.name}.png"
        draw_rollout_strips(model, dataset, f"{task.name}: predicted over true").save(path)
        print(path)

    def _floors(self, task: Task, dataset: Dataset) -> dict[str, Any]:
        """Sampling and chaos floors, and the onsets' own, of demonstrations and of practice."""
        from pwm_gym.data.simulated import SceneMeshes, simulator_of
        from pwm_gym.evaluation.floors import chaos_floor, sampling_floor
        from pwm_gym.evaluation.onsets import onset_floor
        from pwm_gym.evaluation.report import SPLITS
        from pwm_gym.scene import sample_clouds

        simulator = simulator_of(task, dataset)
        meshes, found = SceneMeshes(simulator), dict[tuple[str, ...], Any]()

        def fresh(episode: Episode) -> Any:
            if episode.assets not in found:
                surfaces = meshes(dataset.scene(episode))
                found[episode.assets] = sample_clouds(surfaces, task.layout, task.cloud_seed + 1000)
            return found[episode.assets]

        floors: dict[str, Any] = {}
        for split, suffix in (("all", ""), ("practice", ", practice")):
            chosen = dataset.of_kinds(SPLITS[split])
            if chosen.episodes:
                floors[f"sampling{suffix}"] = sampling_floor(chosen, fresh)
                floors[f"chaos{suffix}"] = chaos_floor(simulator, task, chosen)
                floors[f"onsets{suffix}"] = onset_floor(simulator, chosen)
        simulator.close()
        return floors

    def _long(self, task: Task, model: Any, dataset: Dataset) -> dict[str, Any]:
        """Errors along long rollouts, drawn where asked for."""
        from pwm_gym.data.simulated import simulator_of
        from pwm_gym.evaluation.long import error_curves, mixed_episodes
        from pwm_gym.viewer import draw_quartiles

        with closing(simulator_of(task, dataset)) as simulator:
            curves = error_curves(model, mixed_episodes(simulator, task, dataset, self.long))
        for length, value in curves.mean_chamfer.items():
            print(f"{length} steps of mixed actions: Chamfer L1 {value:.4f} m on average")
        if self.pictures is not None:
            panels = {f"{name}: position error (mm)": v for name, v in curves.positions.items()}
            picture = draw_quartiles(panels, f"{task.name}: {self.long} rollouts of mixed actions")
            picture.save(self.pictures / "long_rollouts.png")
        return curves.summary()

    def _calibration(self, task: Task, row: dict[str, Any]) -> None:
        """Print how well a model's expected errors rank its real ones, and draw them where asked for."""
        told = row["all"].get("calibration") if "all" in row else None
        if told is None:
            return
        known = {name: value for name, value in told["rank_correlation"].items() if value is not None}
        ranks = ", ".join(f"{name} {value:.2f}" for name, value in known.items())
        print(f"rank correlation of expected and real errors: {ranks}")
        if self.pictures is not None:
            from pwm_gym.viewer import draw_calibration

            picture = draw_calibration(told["bins"], f"{task.name}: does the model know how far off it is?")
            picture.save(self.pictures / "calibration.png")

    def _table(self, name: str) -> None:
        from pwm_gym.errors import look_up
        from pwm_gym.evaluation import write_results
        from pwm_gym.experiments import TABLES
        from pwm_gym.experiments.members import PLANNING_TABLES

        runs: dict[str, Callable[[], dict[str, Any]]] = {
            **{key: partial(self._trained, key) for key in TABLES},
            **{key: partial(self._planned, key) for key in PLANNING_TABLES},
            "shared": self._shared,
            "distractors": self._distractors,
        }
        table = look_up("table", name, runs)()
        if self.json is not None:
            asked = {"objects": self.objects} if self.objects else {}
            write_results(self.json, {"table": name, **asked, **table})

    def _trained(self, name: str) -> dict[str, Any]:
        """A table whose rows are trained."""
        from pwm_gym.experiments import run_table

        table = run_table(
            name,
            data_folder(self.task, self.data),
            self.out,
            self.task,
            crew(self.workers, self.ray),
            self.objects,
            rows=self.members,
            scale=self.scale,
            seeds=self.seeds,
        )
        from pwm_gym.evaluation.text import trained_text

        print(trained_text(table))
        return table

    def _planned(self, name: str) -> dict[str, Any]:
        """A table of planning."""
        from pwm_gym.experiments import run_planning_table
        from pwm_gym.experiments.members import PLANNING_TABLES
        from pwm_gym.process import prepare_process

        prepare_process(self.threads)
        draw = None if self.pictures is None else partial(draw_failures, self.pictures)
        data = data_folder(self.task, self.data)
        chosen = PLANNING_TABLES[name]
        table = run_planning_table(
            chosen, data, self.out, self.task, self.full, self.members, draw, self.objects, self.modes, self.scale
        )
        from pwm_gym.evaluation.text import planning_text

        print(planning_text(table))
        return table

    def _shared(self) -> dict[str, Any]:
        """Checkpoints of several tasks against those of one."""
        from pwm_gym.experiments import run_shared_table
        from pwm_gym.tasks import get_task

        tasks = tuple(get_task(name).name for name in self.tasks or (self.task,))
        data = {task: data_folder(task, self.data if len(tasks) == 1 else None) for task in tasks}
        who = crew(self.workers, self.ray)
        table = run_shared_table(self.checkpoints, tasks, data, self.out, self.episodes, who, self.objects)
        from pwm_gym.evaluation.text import shared_text

        print(shared_text(table))
        return table

    def _distractors(self) -> dict[str, Any]:
        """A checkpoint among objects that it never saw."""
        from pwm_gym.dynamics import load_checkpoint, resolve
        from pwm_gym.experiments import run_distractor_table
        from pwm_gym.process import prepare_process
        from pwm_gym.tasks import get_task

        prepare_process(self.threads)
        task = get_task(self.task)
        checkpoint = load_checkpoint(resolve(self.checkpoint, task.name))
        table = run_distractor_table(checkpoint, task, self.episodes)
        influence = table["influence"]
        print(f"{task.name} among distractors, {table['episodes']} scenes: predictions change by (mm)")
        print(f"  {influence['own_mm']}; distractors move by {influence['distractors_mm']}")
        planning = table["planning"]
        print(
            f"  planning succeeds in {planning['successes']}, distractors pushed by {planning['distractors_pushed_mm']}"
        )
        return table


def _completed_starts(task: Task, dataset: Dataset, completer: str, sensor: str) -> dict[str, RigidState]:
    """What perception makes of the episodes' first views, from each of three places."""
    from pwm_gym.cameras.viewpoints import CAMERA_SCALE, VIEWPOINTS
    from pwm_gym.completion import build_completer
    from pwm_gym.data.simulated import SceneMeshes, simulator_of
    from pwm_gym.evaluation.rollouts import completed_start
    from pwm_gym.perception.build import build_observer

    made = build_completer(completer)
    with closing(simulator_of(task, dataset)) as simulator:
        meshes = SceneMeshes(simulator)

        def observer(camera: DepthCamera, scene: Scene) -> RenderedObserver:
            return build_observer(task, dataset.layout, meshes(scene), scene.clouds, made, camera, sensor)

        views = {name: camera.resize(CAMERA_SCALE) for name, camera in VIEWPOINTS.items()}
        return {name: completed_start(dataset, partial(observer, view)) for name, view in views.items()}
