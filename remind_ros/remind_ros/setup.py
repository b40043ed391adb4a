"""Installation by colcon; `remind-jax` itself is installed before, from a clone."""

from setuptools import setup

PACKAGE = "remind_ros"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=[PACKAGE],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", ["launch/identify.launch.py"]),
        (f"share/{PACKAGE}/config", ["config/identify.yaml"]),
    ],
    install_requires=["setuptools", "remind-jax"],
    extras_require={"bags": ["rosbags"]},
    zip_safe=True,
    license="Apache-2.0",
    description="Long-term identities of objects in images",
    entry_points={
        "console_scripts": [
            "identify = remind_ros.node:main",
            "identify_bag = remind_ros.bag:main",
        ]
    },
)
