"""Whether a predicate certainly holds, or certainly does not, by a sketch of the start; None where that is open.

Bounds are wide on purpose: a lint speaks only where every sensible reading of the predicate agrees.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from simfoundry.lint.convex import CLOSE, Piece
from simfoundry.lint.frames import Vec
from simfoundry.lint.sketch import Sketch
from simfoundry.lint.things import Thing, bounds, extent, is_even, landing, middle
from simfoundry.scene.lengths import length
from simfoundry.spec.models.expressions import Call, parse_call, parts

FAR_OFF = 0.03
"""What is this far [m] over another thing does not rest on it, whatever the tolerance is."""

RESTING = 0.001
"""What is no farther than this [m] over another thing rests on it."""

BESIDE = 0.01
"""Bounds that are this far apart [m] belong to things that are apart, whatever the tolerance is."""

LEVEL = 0.005
"""Middles closer together than this along a direction [m] are neither left nor right, neither before nor behind."""

ELSEWHERE = 0.10
"""What is this far from a point [m] is not at it."""

OPEN_SHARE, CLOSED_SHARE = 0.10, 0.05
"""A joint is not closed beyond the one share of its way, and is closed within the other; between lies what is open to
argument (OmniGibson asks for 5 or 10 % of the way, by its version)."""

UPRIGHT_COSINE = 1 - 1e-9
"""What leans by less than the angle of this stands straight."""

TILTED_DEG, UPRIGHT_DEG = 15.0, 5.0
"""A thing leaning by more than the one is not upright, by less than the other it is [deg]."""


class Verdict(NamedTuple):
    """True, False or None, and why."""

    value: bool | None
    why: str = ""


OPEN = Verdict(None)


def judge(condition: Any, drawn: Sketch) -> Verdict:
    """The verdict on a condition; of one that is true, the reasons of its parts."""
    tag, below = parts(condition)
    if tag == "text":
        return verdict(parse_call(below[0]), drawn)
    verdicts = [judge(item, drawn) for item in below]
    values = [v.value for v in verdicts]
    if tag == "not":
        return Verdict(None if values[0] is None else not values[0])
    if not values:
        return OPEN
    decisive = tag == "any"  # one true part decides `any`, one false part decides `all`
    if decisive in values:
        return Verdict(decisive, verdicts[values.index(decisive)].why)
    if None in values:
        return OPEN
    return Verdict(not decisive, "; ".join(v.why for v in verdicts if v.why))


def verdict(call: Call, drawn: Sketch) -> Verdict:
    """The verdict on one predicate."""
    things = [drawn.things.get(arg.partition(".")[0]) for arg in call.args]
    if not things or things[0] is None or not things[0].usable:
        return OPEN
    if len(things) > 1 and call.kinds[1] == "thing" and (things[1] is None or not things[1].usable):
        return OPEN
    if (value := call.declaration.before_motion) is not None:
        return Verdict(value, f"no robot touches `{call.args[0]}`" + ("" if value else " yet"))
    rule = _RULES.get(call.predicate)  # of a predicate that a package brings, only the judge knows the rule
    return OPEN if rule is None else rule(call, drawn)


class _Side(NamedTuple):
    """An argument of a predicate: its name, the thing, the link of it that is meant, and its bounds."""

    name: str
    thing: Thing
    link: str
    low: Vec
    high: Vec

    @property
    def middle(self) -> Vec:
        return middle(self.low, self.high)


def _side(name: str, drawn: Sketch) -> _Side:
    owner, _, link = name.partition(".")
    thing = drawn.things[owner]
    return _Side(name, thing, link, *bounds(thing.part(link)))


def _sides(call: Call, drawn: Sketch) -> tuple[_Side, _Side]:
    return _side(call.args[0], drawn), _side(call.args[1], drawn)


def _gap(a: _Side, b: _Side) -> float:
    """How far the bounds of two are apart along the ground [m]; 0 where they overlap."""
    along = [max(0.0, a.low[k] - b.high[k], b.low[k] - a.high[k]) for k in range(2)]
    return math.hypot(*along)


def _raised(a: _Side, b: _Side) -> float | None:
    """How far ``a`` must be raised to lie on ``b`` [m]; None beside it."""
    return landing(a.thing.pieces_of(a.link), b.thing.pieces_of(b.link))


def _own_middle(a: _Side) -> Vec:
    """The middle of the box around a thing in its own frame, in the world [m]."""
    X_WA = a.thing.limb_frame(a.link)
    p = (0.0, 0.0, 0.0)
    for n in (X_WA.axis(k) for k in range(3)):
        half = sum(extent(a.thing.part(a.link), n)) / 2
        p = (p[0] + half * n[0], p[1] + half * n[1], p[2] + half * n[2])
    return p


def _over(a: _Side, b: _Side) -> bool:
    """Whether the middle of ``a`` is certainly within the outline of an upright ``b``, seen from above."""
    X_WB = b.thing.limb_frame(b.link)
    if not (a.thing.sure and b.thing.sure) or abs(X_WB.axis(2)[2]) < UPRIGHT_COSINE:
        return False
    p = _own_middle(a)
    (x1, x2, _), (y1, y2, _) = X_WB.axis(0), X_WB.axis(1)
    s = math.sqrt(0.5)
    for x, y in ((x1, x2), (y1, y2), (s * (x1 + y1), s * (x2 + y2)), (s * (x1 - y1), s * (x2 - y2))):
        low, high = extent(b.thing.part(b.link), (x, y, 0.0))
        if not low + CLOSE < p[0] * x + p[1] * y < high - CLOSE:
            return False
    return True


def _is_balanced(a: _Side, b: _Side) -> bool:
    """Whether the centre of mass of ``a`` is certainly over ``b`` where its middle is."""
    pieces = a.thing.pieces_of(a.link)
    if len(pieces) == 1 and is_even(pieces[0]):
        return True
    corners = [(x, y, a.high[2]) for x in (a.low[0], a.high[0]) for y in (a.low[1], a.high[1])]
    other = b.thing.pieces_of(b.link)
    return all(landing((Piece.of([corner]),), other) is not None for corner in corners)


def _is_certain(*sides: _Side) -> bool:
    return all(s.thing.sure and s.thing.exact and s.thing.solid for s in sides)


def _is_put(a: _Side, b: _Side) -> bool:
    """Whether the place of the one names the other, or a link of it where the whole is asked for."""
    return bool(a.thing.carrier) and b.name in (a.thing.carrier, a.thing.carrier.partition(".")[0])


def _on_top(call: Call, drawn: Sketch) -> Verdict:
    a, b = _sides(call, drawn)
    if a.thing is b.thing:
        return OPEN
    stands = a.low[2] >= b.high[2] - RESTING and _over(a, b) and _is_balanced(a, b)
    if _is_put(a, b):
        certain = stands and not a.thing.inside
        return Verdict(True, f"`{a.name}` is put on `{b.name}`") if certain else OPEN
    gap = _gap(a, b)
    if gap > BESIDE:
        return Verdict(False, f"`{a.name}` is {length(gap)} beside `{b.name}`")
    if not _is_certain(a, b):
        return OPEN
    if a.high[2] < b.low[2]:
        return Verdict(False, f"`{a.name}` is below `{b.name}`")
    raised = _raised(a, b)
    if raised is None:
        return Verdict(False, f"`{a.name}` is beside `{b.name}`") if a.low[2] < b.high[2] - FAR_OFF else OPEN
    if raised < -FAR_OFF:
        return Verdict(False, f"`{a.name}` is {length(-raised)} above `{b.name}`")
    lies = abs(raised) <= RESTING - CLOSE
    return Verdict(True, f"`{a.name}` stands on `{b.name}`") if stands and lies else OPEN


def _inside(call: Call, drawn: Sketch) -> Verdict:
    a, b = _sides(call, drawn)
    if a.thing is b.thing:
        return OPEN
    X_WB = b.thing.limb_frame(b.link)
    deep = math.inf
    for k in range(3):
        n = X_WB.axis(k)
        if abs(n[2]) > 1e-6 and not (a.thing.exact and b.thing.exact):
            continue  # the height is a guess
        low, high = extent(b.thing.part(b.link), n)
        at = sum(p * v for p, v in zip(a.middle, n, strict=True))
        deep = min(deep, at - low, high - at)
    if deep < -LEVEL:
        return Verdict(False, f"the middle of `{a.name}` is {length(-deep)} outside of `{b.name}`")
    if deep < LEVEL:
        return OPEN
    fits = (a.thing.exact and b.thing.exact) or a.high[2] - a.low[2] < b.high[2] - b.low[2]
    if _is_put(a, b) and a.thing.inside and fits:
        return Verdict(True, f"`{a.name}` is put inside `{b.name}`")
    if not _is_certain(a, b):
        return OPEN
    raised = _raised(a, b)
    within = raised is not None and abs(raised) <= LEVEL
    return Verdict(True, f"`{a.name}` lies in `{b.name}`") if within else OPEN


_DIRECTIONS = {
    "LeftOf": (1, 1.0, "left of", "right of"),
    "RightOf": (1, -1.0, "right of", "left of"),
    "Behind": (0, 1.0, "behind", "in front of"),
    "InFrontOf": (0, -1.0, "in front of", "behind"),
}
"""The axis of the viewer's frame (0 away, 1 left), the sign along it, the direction and its opposite in words."""


def _direction(call: Call, drawn: Sketch) -> Verdict:
    axis, sign, word, opposite = _DIRECTIONS[call.predicate]
    a, b = _sides(call, drawn)
    x, y, z = drawn.viewer.axis(axis)
    n = (sign * x, sign * y, sign * z)
    d = sum((p - q) * v for p, q, v in zip(a.middle, b.middle, n, strict=True))
    if d < -LEVEL:
        viewpoint = drawn.spec.viewpoint
        seen = f", seen from `{viewpoint}`" if viewpoint is not None else ""
        return Verdict(False, f"`{a.name}` is {length(-d)} {opposite} `{b.name}`{seen}")
    apart = extent(a.thing.part(a.link), n)[0] - extent(b.thing.part(b.link), n)[1]
    return Verdict(True, f"`{a.name}` is {length(d)} {word} `{b.name}`") if apart > LEVEL else OPEN


def _above(call: Call, drawn: Sketch) -> Verdict:
    """Above, or Under: the plumb line through the middle of the first meets the second under it, or over it."""
    a, b = _sides(call, drawn)
    gap = _gap(a, b)
    if gap > BESIDE:
        return Verdict(False, f"`{a.name}` is {length(gap)} beside `{b.name}`")
    if not (a.thing.exact and b.thing.exact):
        return OPEN
    x, y, z = _own_middle(a)
    over = call.predicate == "Above"
    beyond = b.low[2] - z if over else z - b.high[2]  # how far all of the second is on the other side
    if beyond > LEVEL:
        word = "below" if over else "above"
        return Verdict(False, f"the middle of `{a.name}` is {length(beyond)} {word} all of `{b.name}`")
    apart = a.low[2] - b.high[2] if over else b.low[2] - a.high[2]
    if not _is_certain(a, b) or apart < -CLOSE:
        return OPEN
    lines = [(x, y, z), (x + BESIDE, y, z), (x - BESIDE, y, z), (x, y + BESIDE, z), (x, y - BESIDE, z)]
    met = all(landing((Piece.of([p]),), b.thing.pieces_of(b.link)) is not None for p in lines)
    return Verdict(True, f"`{a.name}` is {call.predicate.lower()} `{b.name}`") if met else OPEN


def _touching(call: Call, drawn: Sketch) -> Verdict:
    if call.args[1].partition(".")[0] not in drawn.things:
        return OPEN  # a robot
    a, b = _sides(call, drawn)
    if _is_put(a, b) or _is_put(b, a):
        return Verdict(True, f"`{a.name}` and `{b.name}` are put together")
    gap = max(_gap(a, b), a.low[2] - b.high[2], b.low[2] - a.high[2])
    if gap > BESIDE and a.thing.exact and b.thing.exact:
        return Verdict(False, f"`{a.name}` is {length(gap)} away from `{b.name}`")
    return OPEN


def _next_to(call: Call, drawn: Sketch) -> Verdict:
    a, b = _sides(call, drawn)
    gap = _gap(a, b)
    if gap > sum(max(h - low for low, h in zip(s.low, s.high, strict=True)) for s in (a, b)):
        return Verdict(False, f"`{a.name}` is {length(gap)} away from `{b.name}`")
    return OPEN


def _at(call: Call, drawn: Sketch) -> Verdict:
    a = _side(call.args[0], drawn)
    wanted = [float(v) for v in call.args[1:]]
    if len(wanted) == 3 and not a.thing.exact:
        wanted = wanted[:2]
    off = [math.dist(p[: len(wanted)], wanted) for p in (a.thing.limb_frame(a.link).p, a.middle)]
    if min(off) > ELSEWHERE:
        return Verdict(False, f"`{a.name}` is {length(min(off))} away from there")
    return Verdict(True, f"`{a.name}` is there") if max(off) < LEVEL else OPEN


def _upright(call: Call, drawn: Sketch) -> Verdict:
    a = _side(call.args[0], drawn)
    tilt = math.degrees(math.acos(max(-1.0, min(1.0, a.thing.limb_frame(a.link).r[8]))))
    if tilt > TILTED_DEG:
        return Verdict(False, f"`{a.name}` is tilted by {tilt:.0f} deg")
    return Verdict(True, f"`{a.name}` is upright") if tilt < UPRIGHT_DEG else OPEN


def _joint(call: Call, drawn: Sketch) -> Verdict:
    """Open or Closed: of an object with several joints, every one."""
    name, _, wanted = call.args[0].partition(".")
    thing = drawn.things[name]
    joints = {n: j for n, j in thing.joints.items() if not wanted or n == wanted}
    found = list[bool | None]()
    for joint, turn in joints.items():
        if turn.limits is None:
            return OPEN
        low, high = turn.limits
        closed = {"lower": low, "upper": high}.get(turn.closed, min(max(0.0, low), high))
        share = abs(turn.position - closed) / (high - low)
        is_open = True if share > OPEN_SHARE else False if share < CLOSED_SHARE else None
        value = is_open if call.predicate == "Open" or is_open is None else not is_open
        if value is False:
            return Verdict(False, f"`{name}.{joint}` is open by {share * 100:.0f} % of its way")
        found.append(value)
    if not found or None in found:
        return OPEN
    return Verdict(True, f"`{call.args[0]}` is {call.predicate.lower()}")


_RULES: dict[str, Callable[[Call, Sketch], Verdict]] = {
    "OnTop": _on_top,
    "Inside": _inside,
    **dict.fromkeys(_DIRECTIONS, _direction),
    **dict.fromkeys(("Above", "Under"), _above),
    "Touching": _touching,
    "NextTo": _next_to,
    "At": _at,
    "Upright": _upright,
    **dict.fromkeys(("Open", "Closed"), _joint),
}
