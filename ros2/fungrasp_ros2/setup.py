from setuptools import setup

NAME = "fungrasp_ros2"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    # fungrasp and ruckig come from pip: 'pip install "fungrasp[deploy,ur]"' into the Python that ROS runs.
    install_requires=["setuptools"],
    zip_safe=True,
    license="Apache-2.0",
    description="ROS 2 for fungrasp",
    entry_points={
        "console_scripts": [f"grasp_node = {NAME}.grasp_node:main", f"cell_urdf = {NAME}.cell_urdf:main"],
        "fungrasp.arm_drivers": [f"ros2 = {NAME}.joint_loop:make_arm"],
        "fungrasp.hand_drivers": [f"ros2 = {NAME}.joint_loop:make_hand"],
        "fungrasp.pose_sources": [f"ros2 = {NAME}.pose_source:make_pose_source"],
    },
)
