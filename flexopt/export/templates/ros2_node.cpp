// A ROS 2 node around the exported controller: joint states and a target in, joint torques out.
//
// The controller itself (class Controller) needs no ROS; compiled without ROS 2 the file becomes a program that runs it
// once. With ROS 2 (C++17, package rclcpp, sensor_msgs, geometry_msgs, std_msgs) it is a node:
//
//   subscribes  joint_states     sensor_msgs/JointState         the actuated joints by name, {{ joint_units }}{{ ", and their rates" if damped }}
//               end_point        geometry_msgs/PointStamped     measured, inertial frame, m
//               target           geometry_msgs/PointStamped     wanted, inertial frame, m
//   publishes   joint_torques    std_msgs/Float64MultiArray     {{ unit }}, in the order of the machine's joints
//
// Torques go out for each end_point that comes in. The gains are for {{ rate }} of them a second, joint_states as fast:
{% if hold.decays %}
// then the machine's loop about rest decays in the posture ({{ posture | join(", ") }}),{% if placement %} the base at 0,{% endif %} and with
// every other sample lost, too. Elsewhere it may not; `flexopt evaluate` tells, with these gains and
{% else %}
// a beginning, as in none of the postures that were tried such gains make the machine's loop about rest decay.
// `flexopt evaluate` tells which do, with
{% endif %}
// `--loop drive=torque --loop rate={{ rate }} --loop kp=... --loop kv=...{% if damped %} --loop nullspace_damping=...{% endif %}`.
// Nothing is published while an input is missing or refused by the library, nor where, by their stamps, joint_states are older
// than the end_point, or this than the one before, by more than the time-out of {{ age_max }} samples. A target holds until another comes.
// Where no end_point comes nothing is published, either: what takes the torques needs a watchdog of its own.
#include <array>
#include <cstddef>
#include <cstdio>
#include <string>

#include "{{ prefix }}_control.h"

class Controller {
 public:
  static constexpr std::size_t kJoints = {{ PREFIX }}_JOINTS;
  static constexpr std::size_t kTask = {{ PREFIX }}_TASK;
  static constexpr double kRate = {{ rate }};  // of end_point and joint_states, Hz
  static constexpr double kTimeout = {{ age_max }} / kRate;  // s
  static const std::array<std::string, kJoints>& joint_names() {
    static const std::array<std::string, kJoints> names = {{ "{{" }}{% for joint in joints %}"{{ joint | c_text }}"{% if not loop.last %}, {% endif %}{% endfor %}{{ "}}" }};
    return names;
  }

  Controller(double proportional_gain, double derivative_gain{% if damped %}, double nullspace_damping{% endif %}) {
    input_.proportional_gain = static_cast<{{ prefix }}_real>(proportional_gain);
    input_.derivative_gain = static_cast<{{ prefix }}_real>(derivative_gain);
{% if damped %}
    // Of the self-motion.
    input_.nullspace_damping = static_cast<{{ prefix }}_real>(nullspace_damping);
{% endif %}
{% if not baked %}
    {{ prefix }}_default_parameters(&parameters_);
{% endif %}
  }

  void set_joint(std::size_t joint, double angle) { input_.joint_angles[joint] = static_cast<{{ prefix }}_real>(angle); }
{% if damped %}
  void set_rate(std::size_t joint, double rate) { input_.joint_rates[joint] = static_cast<{{ prefix }}_real>(rate); }
{% endif %}
{% if placement %}
  void set_placement(std::size_t k, double value) { input_.placement[k] = static_cast<{{ prefix }}_real>(value); }
{% endif %}
  void set_target(std::size_t axis, double value) { input_.target_point[axis] = static_cast<{{ prefix }}_real>(value); }

  // The rate comes from two measurements, `elapsed` seconds apart.
  void set_measured(const std::array<double, kTask>& point, double elapsed) {
    for (std::size_t i = 0; i < kTask; ++i) {
      const double before = static_cast<double>(input_.measured_point[i]);
      input_.measured_rate[i] = static_cast<{{ prefix }}_real>(elapsed > 0.0 ? (point[i] - before) / elapsed : 0.0);
      input_.measured_point[i] = static_cast<{{ prefix }}_real>(point[i]);
    }
  }

  {{ prefix }}_status step(std::array<double, kJoints>& torque) {
    {{ prefix }}_torque_inverse_out command;
    const {{ prefix }}_status status =
        {{ prefix }}_torque_inverse(&input_, {% if not baked %}&parameters_, {% endif %}&command, workspace_.data(), workspace_.size());
    if ({{ prefix }}_has_output(status)) {
      for (std::size_t j = 0; j < kJoints; ++j) torque[j] = static_cast<double>(command.torque[j]);
    }
    return status;
  }

 private:
  {{ prefix }}_torque_inverse_in input_{};
{% if not baked %}
  {{ prefix }}_parameters parameters_{};
{% endif %}
  std::array<{{ prefix }}_real, {{ PREFIX }}_TORQUE_INVERSE_WORKSPACE> workspace_{};
};

#if defined(__has_include)
#if __has_include(<rclcpp/rclcpp.hpp>)
#define WITH_ROS2 1
#endif
#endif

#ifdef WITH_ROS2

#include <algorithm>
#include <chrono>
#include <geometry_msgs/msg/point_stamped.hpp>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>
#include <vector>

class ControllerNode : public rclcpp::Node {
 public:
  ControllerNode()
      : Node("{{ prefix }}_controller"),
        controller_({% for name, value in gains.items() %}declare_parameter("{{ name }}", {{ value }}){{ ", " if not loop.last }}{% endfor %}),
        timeout_(rclcpp::Duration::from_seconds(declare_parameter("timeout", Controller::kTimeout))) {
{% if placement %}
    // Where the base stands: {{ placement | join(", ") }}.
    const auto placement = declare_parameter("placement", std::vector<double>({{ PREFIX }}_PLACEMENT, 0.0));
    for (std::size_t k = 0; k < placement.size() && k < {{ PREFIX }}_PLACEMENT; ++k) {
      controller_.set_placement(k, placement[k]);
    }
{% endif %}
    torques_ = create_publisher<std_msgs::msg::Float64MultiArray>("joint_torques", 1);
    joints_ = create_subscription<sensor_msgs::msg::JointState>(
        "joint_states", rclcpp::SensorDataQoS(), [this](const sensor_msgs::msg::JointState& m) { on_joints(m); });
    measured_ = create_subscription<geometry_msgs::msg::PointStamped>(
        "end_point", rclcpp::SensorDataQoS(), [this](const geometry_msgs::msg::PointStamped& m) { on_measured(m); });
    target_ = create_subscription<geometry_msgs::msg::PointStamped>(
        "target", 1, [this](const geometry_msgs::msg::PointStamped& m) { on_target(m); });
  }

 private:
  // The rows of the task.
  static std::array<double, Controller::kTask> coordinates(const geometry_msgs::msg::PointStamped& m) {
    return {{ "{{" }}{% for row in machine.task_rows %}m.point.{{ row }}{{ ", " if not loop.last }}{% endfor %}{{ "}}" }};
  }

  void on_joints(const sensor_msgs::msg::JointState& m) {
    const auto& names = Controller::joint_names();
    for (std::size_t j = 0; j < Controller::kJoints; ++j) {
      const auto found = std::find(m.name.begin(), m.name.end(), names[j]);
      const auto index = static_cast<std::size_t>(found - m.name.begin());
      if (found == m.name.end() || index >= m.position.size(){% if damped %} || index >= m.velocity.size(){% endif %}) return;
      controller_.set_joint(j, m.position[index]);
{% if damped %}
      controller_.set_rate(j, m.velocity[index]);
{% endif %}
    }
    joints_time_ = m.header.stamp;
    have_joints_ = true;
  }

  void on_target(const geometry_msgs::msg::PointStamped& m) {
    const auto point = coordinates(m);
    for (std::size_t i = 0; i < Controller::kTask; ++i) controller_.set_target(i, point[i]);
    have_target_ = true;
  }

  void on_measured(const geometry_msgs::msg::PointStamped& m) {
    const rclcpp::Time now(m.header.stamp);
    const auto point = coordinates(m);
    const bool slow = have_measured_ && now - measured_time_ > timeout_;
    const bool has_rate = have_measured_ && !slow;
    controller_.set_measured(point, has_rate ? (now - measured_time_).seconds() : 0.0);
    measured_time_ = now;
    have_measured_ = true;
    if (slow) {
      RCLCPP_WARN_THROTTLE(get_logger(), *get_clock(), 1000, "end_point comes too slowly for the gains");
    }
    if (!has_rate || !have_joints_ || !have_target_ || now - joints_time_ > timeout_) return;
    std::array<double, Controller::kJoints> torque{};
    const {{ prefix }}_status status = controller_.step(torque);
    if (status != {{ PREFIX }}_OK) {
      RCLCPP_WARN_THROTTLE(get_logger(), *get_clock(), 1000, "%s", {{ prefix }}_status_text(status));
    }
    if (!{{ prefix }}_has_output(status)) return;
    std_msgs::msg::Float64MultiArray message;
    message.data.assign(torque.begin(), torque.end());
    torques_->publish(message);
  }

  Controller controller_;
  rclcpp::Duration timeout_;
  rclcpp::Time joints_time_{0, 0, RCL_ROS_TIME}, measured_time_{0, 0, RCL_ROS_TIME};
  bool have_joints_ = false, have_measured_ = false, have_target_ = false;
  rclcpp::Publisher<std_msgs::msg::Float64MultiArray>::SharedPtr torques_;
  rclcpp::Subscription<sensor_msgs::msg::JointState>::SharedPtr joints_;
  rclcpp::Subscription<geometry_msgs::msg::PointStamped>::SharedPtr measured_, target_;
};

int main(int argc, char** argv) {
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<ControllerNode>());
  rclcpp::shutdown();
  return 0;
}

#else

int main() {
  Controller controller({{ gains.values() | join(", ") }});
  const std::array<double, Controller::kJoints> start = {{ "{{" ~ posture | join(", ") ~ "}}" }};
  for (std::size_t j = 0; j < Controller::kJoints; ++j) controller.set_joint(j, start[j]);
  std::array<double, Controller::kTask> origin{};
  controller.set_measured(origin, 0.0);
  for (std::size_t i = 0; i < Controller::kTask; ++i) controller.set_target(i, 0.01);
  std::array<double, Controller::kJoints> torque{};
  const {{ prefix }}_status status = controller.step(torque);
  std::printf("without ROS 2: %s; torques, {{ unit }}:\n", {{ prefix }}_status_text(status));
  for (std::size_t j = 0; j < Controller::kJoints; ++j) {
    std::printf("  %s %.6g\n", Controller::joint_names()[j].c_str(), torque[j]);
  }
  return {{ prefix }}_has_output(status) ? 0 : 1;
}

#endif
