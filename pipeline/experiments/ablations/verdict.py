"""What learning buys over the rule alone, and what the refiner loses with each thing it lacks."""

import pandas as pd

from pipeline.exhibits.intervals import wilson
from pipeline.exhibits.numbers import percents, share
from pipeline.experiments.ablations.gains import NOTHING, Gain, gain
from pipeline.experiments.ablations.ground import Ground, grounds
from pipeline.experiments.ablations.losses import Loss, losses
from pipeline.experiments.ablations.summary import (
    LACKS,
    at_own_rounds,
    difference,
    percent,
    scored,
)
from pipeline.experiments.answer import FREE, Answer, measured
from pipeline.networks.refiner.ablations import ABLATIONS, LABELLED, SHORT

GAIN = "What does learning buy over the refiner's rule alone?"
NEED = "Is the refiner worse without each of its parts?"
LABELS = "Do the expert's plans as labels help the refiner to learn?"

NO_DIFFERENCE = "no difference beyond noise"

ONCE = ", for one training"


def sentences(ablations: pd.DataFrame) -> list[str]:
    """A paragraph for each family and n: what learning buys, and which lack costs most."""
    found = []
    for ground, rows in _answers(ablations).items():
        labels = losses(rows, [LABELLED])
        said = [_gain_sentence(ground, gain(rows)), _loss_sentence(losses(rows))]
        said += [_labels_sentence(labels), _once(rows)]
        found.append(" ".join(filter(None, said)))
    return found


def ablation_answers(ablations: pd.DataFrame) -> list[Answer]:
    """A row on learning, one on parts and one on labels, where refiners were tried that tell.

    Args:
        ablations: a row for each trial and number of rounds.
    """
    on = _answers(ablations)
    gains = {g: one for g, rows in on.items() if (one := gain(rows))}
    costs = {g: found for g, rows in on.items() if (found := losses(rows))}
    free = {g: rows[rows["planner"] == FREE] for g, rows in on.items()}
    beside = _told({g: f"Own LP: {measured(rows).text}" for g, rows in free.items() if len(rows)})
    answers = []
    if gains:
        once = ONCE if any(_trainings(one.mine) == 1 for one in gains.values()) else ""
        said = _told({g: one.verdict for g, one in gains.items()})
        numbers = _told({g: one.text for g, one in gains.items()})
        answers.append(Answer(GAIN, _capital(said) + once, numbers, beside))
    if costs:
        tried = [on[g][on[g]["recipe"].isin([SHORT, *ABLATIONS])] for g in costs]
        once = ONCE if any(_trainings(rows) == 1 for rows in tried) else ""
        said = _told({g: _part_verdict(found) for g, found in costs.items()})
        numbers = _told(
            {
                g: ", ".join(f"{one.recipe} {one.cost}" for one in found)
                for g, found in costs.items()
            }
        )
        answers.append(Answer(NEED, _capital(said) + once, numbers))
    labels = {g: one for g, rows in on.items() for one in losses(rows, [LABELLED])}
    if labels:
        said = _told({g: _labels_verdict(one) for g, one in labels.items()})
        numbers = _told({g: f"score {one.cost}" for g, one in labels.items()})
        answers.append(Answer(LABELS, _capital(said), numbers))
    return answers


def _answers(ablations: pd.DataFrame) -> dict[Ground, pd.DataFrame]:
    """The scored trials of answers as they are, by family and n."""
    return {} if ablations.empty else grounds(at_own_rounds(scored(ablations)))


def _gain_sentence(ground: Ground, found: Gain | None) -> str:
    if found is None:
        return ""
    held, (low, high) = found.held, found.held.safe_interval
    bought = (
        f"{ground.where} learning buys nothing over the rule alone that is beyond chance"
        if found.verdict == NOTHING
        else f"{ground.where} learning makes plans {found.verdict} than the rule alone"
    )
    return (
        f"{bought}: {found.recipe} leaves {_unsafe(found.mine)} of trials unsafe at "
        f"{_excess(found.mine)} over the bound, the rule {_unsafe(found.rule)} at "
        f"{_excess(found.rule)}; on the same {held.trials:,} trials that is "
        f"{difference(held.fuel, held.fuel_interval)} in fuel and {100 * held.safe:+.1f} % "
        f"[{100 * low:+.1f}, {100 * high:+.1f}] in safe trials."
    )


def _loss_sentence(found: list[Loss]) -> str:
    """The dearest lack first; what is within noise is only named."""
    if not found:
        return ""
    worse, better = ([one for one in found if getattr(one, how)] for how in ("worse", "better"))
    rest = [one for one in found if not (one.worse or one.better)]
    said = f"Of {len(found)} things left out one at a time, "
    if worse:
        costs = [f"{LACKS[one.recipe]} ({one.cost} in score)" for one in worse]
        said += f"{'this is' if len(worse) == 1 else 'these are'} missed beyond noise"
        said += f"{', most first' if len(worse) > 1 else ''}: {_listed(costs)}."
    else:
        said += f"none is missed beyond noise; the dearest lack is that of {LACKS[found[0].recipe]}"
        said += f" ({found[0].cost} in score)."
    if better:
        gains = [f"{LACKS[one.recipe]} ({one.cost})" for one in better]
        said += f" Beyond noise it does better without {_listed(gains)}."
    if rest and worse:
        said += f" Within noise: {_listed([LACKS[one.recipe] for one in rest])}."
    return said


def _labels_sentence(found: list[Loss]) -> str:
    if not found:
        return ""
    (one,) = found
    verdict = _labels_verdict(one)
    said = f"make {verdict}" if verdict == NO_DIFFERENCE else verdict
    return f"Labels from the expert's plans {said} ({one.cost} in score)."


def _labels_verdict(found: Loss) -> str:
    return "harm" if found.worse else "help" if found.better else NO_DIFFERENCE


def _part_verdict(found: list[Loss]) -> str:
    worse = [LACKS[one.recipe] for one in found if one.worse]
    if not worse:
        return "not beyond noise"
    if len(worse) == len(found):
        return f"yes, without any of the {len(found)}; most without {worse[0]}"
    return f"only without {_listed(worse)}"


def _once(rows: pd.DataFrame) -> str:
    trained = rows[rows["recipe"] != ""]
    once = trained.empty or any(_trainings(part) == 1 for _, part in trained.groupby("recipe"))
    said = (
        "Intervals are over the trials; some recipe was trained once, and another training of it "
        "may differ by as much."
    )
    return said if once and len(trained) else ""


def _told(said: dict[Ground, str]) -> str:
    """What is said on each ground, once where it is the same on all."""
    if len(set(said.values())) == 1 and len(said) > 1:
        return next(iter(said.values()))
    return "; ".join(f"{ground.label}: {text}" for ground, text in said.items())


def _capital(text: str) -> str:
    return text if text.startswith("n = ") else text[0].upper() + text[1:]


def _mean(rows: pd.DataFrame, column: str) -> float:
    return float(rows.groupby("trial")[column].mean().mean())


def _unsafe(rows: pd.DataFrame) -> str:
    mean = _mean(rows, "unsafe")
    return f"{share(mean)} {percents(*wilson(mean, rows['trial'].nunique()))}"


def _excess(rows: pd.DataFrame) -> str:
    return percent(_mean(rows, "excess"))


def _trainings(rows: pd.DataFrame) -> int:
    """Trainings of the recipe that has the fewest."""
    return int(rows.groupby("recipe")["training_seed"].nunique().min())


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
