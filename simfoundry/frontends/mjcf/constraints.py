"""Read the sites, contact pairs, tendons and equality constraints of a model."""

from __future__ import annotations

from typing import Any

import numpy as np

from simfoundry.frontends.document_data import Data, native_data, pose_data
from simfoundry.frontends.draft import AttachmentDraft, CompiledName
from simfoundry.frontends.mjcf.native_state import NativeState, exact_values, plain
from simfoundry.geometry.frames import Pose

# Attributes by the model field that contains them.
_SITE = {"group": "site_group", "rgba": "site_rgba"}
_TENDON = {"group": "tendon_group", "margin": "tendon_margin", "stiffness": "tendon_stiffness",
           "springlength": "tendon_lengthspring", "damping": "tendon_damping", "frictionloss": "tendon_frictionloss",
           "armature": "tendon_armature", "solreflimit": "tendon_solref_lim", "solimplimit": "tendon_solimp_lim",
           "solreffriction": "tendon_solref_fri", "solimpfriction": "tendon_solimp_fri", "width": "tendon_width",
           "rgba": "tendon_rgba"}  # fmt: skip
_SITE_TYPES = ("sphere", "capsule", "ellipsoid", "cylinder", "box")


class ConstraintReader(NativeState):
    """A reader of sites, contact pairs, tendons and equality constraints."""

    def read_sites(self) -> None:
        """Add the sites to the draft, and those of the world to the native data."""
        model = self.model
        for k, body in enumerate(model.site_bodyid.tolist()):
            name = self.source.name("site", k) or f"site_{k}"
            native = self.differing(_SITE, k)
            kind = self.mujoco.mjtGeom(model.site_type[k]).name.removeprefix("mjGEOM_").lower()
            if kind != "sphere" and kind in _SITE_TYPES:
                native["type"] = kind
            size = tuple(model.site_size[k].tolist())
            if size != tuple(self.usual.site_size[0].tolist()):
                native["size"] = size
            X_BS = Pose.of(model.site_pos[k], model.site_quat[k])
            if body == 0:
                called = self.names["site"].name(name)
                pos, quat = tuple(X_BS.p.tolist()), tuple(X_BS.q.tolist())
                self.add("worldbody", "site", name=called, pos=pos, quat=quat, **native)
                self.places["site", k] = called
                continue
            owner, link, X_BL = self.source.owners[body]
            native |= {} if self.source.is_own else exact_values(pos=model.site_pos[k], quat=model.site_quat[k])
            data: Data = _posed(X_BL.inverse() @ X_BS) | native_data(native)
            owner.sites.append(AttachmentDraft(name, data, "link", link))
            self.places["site", k] = CompiledName("site", owner.name, name)

    def read_pairs(self) -> None:
        """Add the contact pairs and the exclusions that documents cannot express."""
        model = self.model
        for k in range(model.npair):
            friction, reference = tuple(model.pair_friction[k].tolist()), plain(model.pair_solreffriction[k])
            ends = {f"geom{n}": self.places.get(("geom", int(getattr(model, f"pair_geom{n}")[k]))) for n in (1, 2)}
            if None in ends.values():
                self.source.draft.dropped(f"contact pair {self.source.label('pair', k)}", "its geom is not imported")
                continue
            values = {name: plain(getattr(model, f"pair_{name}")[k]) for name in ("margin", "gap", "solref", "solimp")}
            values |= {"condim": int(model.pair_dim[k]), "friction": friction}
            self.add("contact", "pair", **ends, **values, solreffriction=reference if any(reference) else None)

        for one, two in self.excluded:
            self.add("contact", "exclude", body1=self.ref("body", one), body2=self.ref("body", two))

    def exclude(self, one: int, two: int) -> None:
        """Keep a pair of bodies that do not collide."""
        self.excluded.append((one, two))

    def read_tendons(self) -> None:
        """Add the tendons."""
        model, wraps = self.model, self.mujoco.mjtWrap
        for k in range(model.ntendon):
            name = self.places["tendon", k] = self.names["tendon"].name(self.source.name("tendon", k) or f"tendon_{k}")
            path: list[Data] = []
            is_fixed = False
            for w in range(int(model.tendon_adr[k]), int(model.tendon_adr[k] + model.tendon_num[k])):
                kind, target, value = model.wrap_type[w], int(model.wrap_objid[w]), float(model.wrap_prm[w])
                if kind == wraps.mjWRAP_JOINT:
                    is_fixed = True
                    path.append({"joint": {"joint": self.ref("joint", target), "coef": value}})
                elif kind == wraps.mjWRAP_SITE:
                    path.append({"site": {"site": self.ref("site", target)}})
                elif kind == wraps.mjWRAP_PULLEY:
                    path.append({"pulley": {"divisor": value}})
                else:
                    side = {"sidesite": self.ref("site", round(value))} if value >= 0 else {}
                    path.append({"geom": {"geom": self.ref("geom", target)} | side})
            native = self.differing(_TENDON, k)
            if is_fixed:
                native = {key: value for key, value in native.items() if key not in ("width", "rgba")}
            if "stiffness" in native:
                native["stiffness"] = float(np.ravel(model.tendon_stiffness[k])[0])
            if "damping" in native:
                native["damping"] = float(np.ravel(model.tendon_damping[k])[0])
            native["springlength"] = plain(model.tendon_lengthspring[k])
            if model.tendon_limited[k]:
                native |= {"limited": True, "range": plain(model.tendon_range[k])}
            if model.tendon_actfrclimited[k]:
                native |= {"actuatorfrclimited": True, "actuatorfrcrange": plain(model.tendon_actfrcrange[k])}
            self.add("tendon", "fixed" if is_fixed else "spatial", name=name, **native, path=path)

    def read_equalities(self) -> None:
        """Add the equality constraints, of which mimic joints have only the attributes."""
        model, kinds, objects = self.model, self.mujoco.mjtEq, self.mujoco.mjtObj
        order: list[Any] = []
        for k in range(model.neq):
            kind, data = kinds(model.eq_type[k]), model.eq_data[k]
            one, two = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            native = self.differing({"solref": "eq_solref", "solimp": "eq_solimp"}, k)
            if kind == kinds.mjEQ_JOINT and one in self.source.joints:
                owner, draft = self.source.joints[one]
                if k in self.source.mimics:
                    draft.native |= {"equality": native} if native else {}
                    order.append(CompiledName("joint", owner.name, draft.name))
                    continue
            name = self.source.name("equality", k) or f"equality_{k}"
            given: Data = {"name": name} | ({} if model.eq_active0[k] else {"active": False}) | native
            order.append(name)
            tag = kind.name.removeprefix("mjEQ_").lower()
            if tag in ("joint", "tendon"):
                ends = {f"{tag}1": self.ref(tag, one), f"{tag}2": self.ref(tag, two) if two >= 0 else None}
                self.add("equality", tag, **given, **ends, polycoef=tuple(data[:5].tolist()))
                continue
            if tag not in ("connect", "weld"):
                self.source.draft.dropped(f"{tag} equality `{name}`", "flexible bodies are not imported")
                order.pop()
                continue
            place = "body" if model.eq_objtype[k] == objects.mjOBJ_BODY else "site"
            given |= {f"{place}1": self.ref(place, one), f"{place}2": self.ref(place, two)}
            if place == "body":
                given["anchor"] = tuple(data[:3].tolist())
                if tag == "weld" and not (len(data) > 11 and data[11]):  # otherwise, it follows from the poses
                    given["relpose"] = tuple(data[3:10].tolist())
            if tag == "weld":
                given["torquescale"] = float(data[10])
            self.add("equality", tag, **given)
        self.keep_order("equality", order)


def _posed(X_LS: Pose) -> Data:
    return {"pose": data} if (data := pose_data(X_LS)) else {}
