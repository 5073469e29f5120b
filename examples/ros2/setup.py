from setuptools import setup

setup(
    name="outrider_ros2",
    version="0.1.0",
    packages=["outrider_ros2"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/outrider_ros2"]),
        ("share/outrider_ros2", ["package.xml", "session.json5"]),
        ("share/outrider_ros2/launch", ["launch/see.launch.py"]),
        ("share/outrider_ros2/rviz", ["rviz/outrider.rviz"]),
    ],
    install_requires=["setuptools"],
    entry_points={"console_scripts": ["hover = outrider_ros2.hover:main"]},
)
