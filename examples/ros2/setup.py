from setuptools import setup

setup(
    name="outrider_demo",
    version="0.1.0",
    packages=["outrider_demo"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/outrider_demo"]),
        ("share/outrider_demo", ["package.xml", "session.json5"]),
        ("share/outrider_demo/launch", ["launch/see.launch.py"]),
        ("share/outrider_demo/rviz", ["rviz/outrider.rviz"]),
    ],
    install_requires=["setuptools"],
    entry_points={"console_scripts": ["hover = outrider_demo.hover:main"]},
)
