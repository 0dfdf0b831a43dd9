"""Helpers that make and edit the text of a URDF."""

from pathlib import Path

from moc_opt.robots import loader

FOLDER = Path(loader.__file__).parent


def text_of(name: str = "panda") -> str:
    return (FOLDER / f"{name}.urdf").read_text(encoding="utf-8")


def changed(text: str, *pairs: tuple[str, str]) -> str:
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def added(text: str, more: str) -> str:
    return changed(text, ("</robot>", f"{more}</robot>"))


def link(name: str, mass: float | None = None, inertia: float = 1e-3) -> str:
    if mass is None:
        return f'<link name="{name}"/>'
    moments = f'ixx="{inertia}" iyy="{inertia}" izz="{inertia}"'
    return f'<link name="{name}"><inertial><mass value="{mass}"/><inertia {moments}/></inertial></link>'


def joint(name: str, kind: str, parent: str, child: str, more: str = "") -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'


def with_hand(text: str) -> str:
    """Add a massless flange, a hand, two fingers, shapes and drives."""
    slide = '<axis xyz="0 1 0"/><limit lower="0.01" upper="0.04" velocity="0.2" effort="20"/>'
    mesh = '<visual><geometry><mesh filename="package://nowhere/finger.dae"/></geometry></visual>'
    return added(
        text,
        link("link8", 0.0, 0.0) + joint("joint8", "fixed", "link_7", "link8", '<origin xyz="0 0 0.107"/>')
        + link("hand", 0.7) + joint("hand_joint", "fixed", "link8", "hand", '<origin rpy="0 0 -0.785"/>')
        + link("left", 0.015, 1e-5).replace("</link>", f"{mesh}</link>")
        + joint("finger_1", "prismatic", "hand", "left", slide) + link("right", 0.015, 1e-5)
        + joint("finger_2", "prismatic", "hand", "right", slide + '<mimic joint="finger_1"/>')
        + link("tcp") + joint("tcp_joint", "fixed", "hand", "tcp", '<origin xyz="0 0 0.1"/>')
        + '<transmission name="t"/><gazebo reference="hand"/>',
    )  # fmt: skip
