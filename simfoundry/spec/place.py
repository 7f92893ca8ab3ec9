from __future__ import annotations
from dataclasses import dataclass
@dataclass(frozen=True)
class Place:
    on: str|None=None; inside: str|None=None; xy:tuple[float,float]|None=None; at:tuple[float,float]|None=None
    left_of:str|None=None; right_of:str|None=None; in_front_of:str|None=None; behind:str|None=None
    gap:float=0.03; yaw_deg:float|None=None; rpy_deg:tuple[float,float,float]|None=None
