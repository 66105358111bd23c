// Stand-ins for the names of rclcpp that docs/examples/field_node uses, so that its node can be compiled and called
// without ROS 2. Ours; they show nothing about ROS 2 itself. `spin` feeds rows of pose and currents from stdin.
#pragma once
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "geometry_msgs/msg/pose_stamped.hpp"
#include "geometry_msgs/msg/wrench_stamped.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"

#define RCLCPP_WARN(logger, ...) ((void)(logger), std::fprintf(stderr, __VA_ARGS__), std::fputc('\n', stderr))

namespace rclcpp
{
inline std::string argument;

template<class M>
struct Publisher
{
  using SharedPtr = std::shared_ptr<Publisher>;
  void publish(const M & said)
  {
    const auto & f = said.wrench.force;
    const auto & t = said.wrench.torque;
    const double row[7] = {said.header.stamp, f.x, f.y, f.z, t.x, t.y, t.z};
    std::fwrite(row, 8, 7, stdout);
  }
};

template<class M>
struct Subscription
{
  using SharedPtr = std::shared_ptr<Subscription>;
  std::function<void(typename M::SharedPtr)> call;
};

struct Node
{
  explicit Node(const char *) {}
  template<class T>
  T declare_parameter(const char * name, T usual)
  {
    if constexpr (std::is_same_v<T, std::string>) return argument;
    if constexpr (std::is_same_v<T, std::vector<double>>) return {0.1, -0.2, 0.8};
    return (void)name, usual;
  }
  template<class M>
  typename Publisher<M>::SharedPtr create_publisher(const char *, int)
  {
    return std::make_shared<Publisher<M>>();
  }
  template<class M, class F>
  typename Subscription<M>::SharedPtr create_subscription(const char *, int, F call)
  {
    auto made = std::make_shared<Subscription<M>>();
    made->call = call;
    if constexpr (std::is_same_v<M, geometry_msgs::msg::PoseStamped>) pose = made; else currents = made;
    return made;
  }
  int get_logger() const { return 0; }
  Subscription<geometry_msgs::msg::PoseStamped>::SharedPtr pose;
  Subscription<std_msgs::msg::Float64MultiArray>::SharedPtr currents;
};

inline void init(int argc, char ** argv) { argument = argc > 1 ? argv[1] : ""; }
inline void shutdown() {}
inline void spin(std::shared_ptr<Node> node)
{
  double row[13];
  for (double stamp = 1.0; std::fread(row, 8, 13, stdin) == 13; stamp += 1.0) {
    auto amperes = std::make_shared<std_msgs::msg::Float64MultiArray>();
    amperes->data.assign(row + 7, row + 13);
    node->currents->call(amperes);
    auto said = std::make_shared<geometry_msgs::msg::PoseStamped>();
    said->header.stamp = stamp;
    said->pose.position = {row[0], row[1], row[2]};
    said->pose.orientation = {row[4], row[5], row[6], row[3]};
    node->pose->call(said);
  }
}
}  // namespace rclcpp
