"""Runs of the detection experiment made by hand."""

from supervisor.experiments.detection_trial import BINS


def counts(ss=0, sc=0, su=0, cs=0, cc=0, cu=0, squared_error=0.0) -> dict:
    """A tally by hand: first letter the truth, second what was called."""
    return {
        "confusion": {
            "severed": {"severed": ss, "connected": sc, "unknown": su},
            "connected": {"severed": cs, "connected": cc, "unknown": cu},
        },
        "squared_error": squared_error,
        "bins": [[cc + cs + cu, 0.0, 0]] + [[0, 0.0, 0]] * (BINS - 2) + [[ss + sc + su, float(ss + sc + su), ss + sc + su]],
    }


def run(seed=0, variant="dis", scene="beef", cut="partly", disturbance="none", edges=None, goal_edges=None, **more) -> dict:
    """A run as `run_job` gives it, made by hand."""
    edges = counts(ss=8, sc=2, cs=1, cc=9) if edges is None else edges
    row = {"station": 0.5, "severed": True, "damage": 0.0, "state": "severed", "probability": 0.9, "elongation": 2.5}
    return {
        "variant": variant,
        "seed": seed,
        "scene": scene,
        "cut": cut,
        "disturbance": disturbance,
        "drawn": {},
        "code": "ok",
        "message": "pulled all 12 steps",
        "stopped_by": "exposure_steps_done",
        "steps": 12,
        "edges": edges,
        "goal_edges": edges if goal_edges is None else goal_edges,
        "rows": [row],
        "points": 300,
        "ms": [10.0, 20.0],
        **more,
    }


def failed(**more) -> dict:
    """A run in which nothing could be judged."""
    made = run(code="grasp_empty", stopped_by="", ms=[], points=0, **more)
    return {key: value for key, value in made.items() if key not in ("edges", "goal_edges", "rows")}
