// From a command's frame to the controller and back to a reply.
//
// Sizes and ids are already checked (link/session.h); here payloads are decoded, the controller is
// asked, and its answer becomes the reply. Every refusal is an ack with its reason.
#ifndef THIGMO_CORE_COMMANDS_H_
#define THIGMO_CORE_COMMANDS_H_

#include <stdint.h>

#include "controller.h"
#include "link/session.h"

namespace thigmo {

class Commands {
 public:
  Commands(Controller& controller, Session& session, ConfigStore& store)
      : controller_(controller), session_(session), store_(store) {}

  // Main-loop time and lost bytes, for get_link_stats.
  struct Timing {
    uint16_t loop_max_us;
    uint16_t rx_overruns;
  };
  Timing& timing() { return timing_; }

  void heartbeat() { controller_.beat(); }
  void hello(bool same_host) { controller_.greet(same_host); }
  void stop(uint32_t nonce) { controller_.stop(nonce); }

  Handled execute(const Frame& command, Frame* reply) {
    Reply answer = {reply, command.seq(), command.session()};
    switch (command.id()) {
      case protocol::kGetStatus:
        return status(answer);
      case protocol::kArm:
        return answer.ack(controller_.arm());
      case protocol::kVent:
        return answer.ack(controller_.vent());
      case protocol::kDisarm:
        return answer.ack(controller_.disarm());
      case protocol::kClearStop: {
        const auto m = read<protocol::ClearStop>(command);
        return answer.ack(controller_.clear_stop(m.nonce));
      }
      case protocol::kClearFaults: {
        const auto m = read<protocol::ClearFaults>(command);
        return answer.ack(controller_.clear_faults(m.mask));
      }
      case protocol::kSetPressure: {
        protocol::SetPressure m;
        if (!counted(command, &m)) return answer.ack({Reason::kBadValue, kMuscles});
        return answer.ack(controller_.set_pressure(m));
      }
      case protocol::kGrowTo: {
        const auto m = read<protocol::GrowTo>(command);
        return answer.ack(controller_.grow_to(m.length_um, m.speed_um_s));
      }
      case protocol::kRetractTo: {
        const auto m = read<protocol::RetractTo>(command);
        return answer.ack(controller_.retract_to(m.length_um, m.speed_um_s));
      }
      case protocol::kHome:
        return answer.ack(controller_.home());
      case protocol::kConfirmLength: {
        const auto m = read<protocol::ConfirmLength>(command);
        return answer.ack(controller_.confirm_length(m.length_um, m.settled != 0));
      }
      case protocol::kSelectZone: {
        const auto m = read<protocol::SelectZone>(command);
        return answer.ack(controller_.select_zone(m.zone));
      }
      case protocol::kBodyAir: {
        const auto m = read<protocol::BodyAir>(command);
        return answer.ack(controller_.body_air(m.open));
      }
      case protocol::kTestOutput: {
        const auto m = read<protocol::TestOutput>(command);
        return answer.ack(controller_.test_output(m));
      }
      case protocol::kSweep: {
        protocol::Sweep m;
        if (!counted(command, &m)) return answer.ack({Reason::kBadValue, kMuscles});
        return answer.ack(controller_.sweep(m));
      }
      case protocol::kZeroSensors: {
        const auto m = read<protocol::ZeroSensors>(command);
        return answer.ack(controller_.zero_sensors(m.mask));
      }
      case protocol::kGetSensor: {
        const auto m = read<protocol::GetSensor>(command);
        return sensor(answer, m.sensor);
      }
      case protocol::kGetParameter: {
        const auto m = read<protocol::GetParameter>(command);
        return parameter(answer, m.index);
      }
      case protocol::kSetParameter: {
        const auto m = read<protocol::SetParameter>(command);
        const Outcome outcome = controller_.set_parameter(m.index, m.value);
        if (outcome.reason != Reason::kNone) return answer.ack(outcome);
        return parameter(answer, m.index);
      }
      case protocol::kApplyParameters:
        return deferred(answer, controller_.begin_apply());
      case protocol::kSetMap: {
        const auto m = read<protocol::SetMap>(command);
        return answer.ack(controller_.set_map(m));
      }
      case protocol::kGetMap: {
        const auto m = read<protocol::GetMap>(command);
        return map(answer, m);
      }
      case protocol::kSaveConfig: {
        const Outcome outcome = controller_.begin_save();
        if (outcome.reason != Reason::kNone) return answer.ack(outcome);
        store_.save();
        return Handled::kDeferred;
      }
      case protocol::kLoadDefaults:
        return deferred(answer, controller_.begin_defaults());
      case protocol::kGetSnapshot: {
        const auto m = read<protocol::GetSnapshot>(command);
        return snapshot(answer, m.index);
      }
      case protocol::kAckEvent: {
        const auto m = read<protocol::AckEvent>(command);
        controller_.events().acknowledge(m.number);
        return answer.ack(kAccepted);
      }
      case protocol::kGetLinkStats:
        return stats(answer);
      case protocol::kGetConfigReport:
        return config_report(answer);
      case protocol::kGetTip:
        return answer.send(protocol::TipReport{protocol::Status::kOk, controller_.seen_sensor(),
                                               controller_.seen_um()});
      case protocol::kGetCapacity:
        return answer.send(protocol::Capacity{protocol::Status::kOk, kMuscles, kSensors,
                                              kBodyPressures, kImus, kAdcBits, kDriveFull,
                                              kMotorFull, 1000});
      default:
        return answer.ack({Reason::kUnknownId, command.id()});
    }
  }

 private:
  struct Reply {
    Frame* frame;
    uint16_t seq;
    uint16_t session;

    template <typename Message>
    Handled send(const Message& message) {
      frame->set(message, seq, session);
      return Handled::kReplied;
    }

    Handled ack(const Outcome& outcome) {
      return send(protocol::Ack{
          outcome.reason == Reason::kNone ? protocol::Status::kOk : protocol::Status::kRefused,
          outcome.reason, outcome.detail});
    }
  };

  // The payload; its size was checked before.
  template <typename Message>
  static Message read(const Frame& command) {
    Message message = {};
    Message::decode(command.payload(), command.payload_size(), &message);
    return message;
  }

  // The payload of a command with arrays; false if they count other than the board does.
  template <typename Message>
  static bool counted(const Frame& command, Message* message) {
    return Message::decode(command.payload(), command.payload_size(), message);
  }

  Handled status(Reply& answer) {
    protocol::StatusReport m;
    controller_.fill(&m);
    if (session_.dropped()) {
      m.conditions = static_cast<uint16_t>(m.conditions | mask(Condition::kTelemetryDropped));
      session_.clear_dropped();
    }
    m.config_generation = store_.generation();
    return answer.send(m);
  }

  static Handled deferred(Reply& answer, const Outcome& outcome) {
    return outcome.reason == Reason::kNone ? Handled::kDeferred : answer.ack(outcome);
  }

  Handled sensor(Reply& answer, uint8_t index) {
    if (index >= kSensors) return answer.ack({Reason::kBadValue, index});
    protocol::SensorReport m;
    controller_.fill(index, &m);
    return answer.send(m);
  }

  Handled parameter(Reply& answer, uint16_t index) {
    if (index >= protocol::kParamCount) return answer.ack({Reason::kBadValue, index});
    return answer.send(
        protocol::ParameterValue{protocol::Status::kOk, index, controller_.parameter(index)});
  }

  Handled map(Reply& answer, const protocol::GetMap& wanted) {
    const uint8_t branch = static_cast<uint8_t>(wanted.branch);
    if (wanted.zone >= kBodyPressures || wanted.muscle >= kMuscles || branch >= kBranches) {
      return answer.ack({Reason::kBadValue, 0});
    }
    protocol::MapValues m;
    m.status = protocol::Status::kOk;
    m.zone = wanted.zone;
    m.muscle = wanted.muscle;
    m.branch = wanted.branch;
    for (uint8_t i = 0; i < protocol::kMapPoints; ++i) {
      m.curvature_e5[i] = controller_.configuration().map[wanted.zone][wanted.muscle][branch][i];
    }
    return answer.send(m);
  }

  Handled snapshot(Reply& answer, uint8_t index) {
    const Reading* reading = controller_.snapshots().find(index);
    if (reading == nullptr) return answer.ack({Reason::kNoSnapshot, index});
    protocol::Snapshot m;
    m.status = protocol::Status::kOk;
    m.index = index;
    m.count = controller_.snapshots().count();
    m.muscle = reading->muscle;
    m.branch = reading->branch;
    m.t_us = reading->t_us;
    for (uint8_t i = 0; i < kSensors; ++i) m.flex_sum[i] = reading->flex_sum[i];
    for (uint8_t i = 0; i < kMuscles; ++i) m.pressure_cpsi[i] = reading->cpsi[i];
    m.lagged_cpsi = reading->lagged_cpsi;
    m.base_e5 = reading->base_e5;
    m.free_e5 = reading->free_e5;
    return answer.send(m);
  }

  Handled stats(Reply& answer) {
    const Session::Counters& c = session_.counters();
    protocol::LinkStats m;
    m.status = protocol::Status::kOk;
    m.rx_frames = c.rx_frames;
    m.rx_bad = c.rx_bad;
    m.rx_stale = c.rx_stale;
    m.rx_repeats = c.rx_repeats;
    m.rx_overruns = timing_.rx_overruns;
    m.tx_dropped = c.tx_dropped;
    m.loop_max_us = timing_.loop_max_us;
    timing_.loop_max_us = 0;
    return answer.send(m);
  }

  Handled config_report(Reply& answer) {
    const StoredReport& r = store_.report();
    protocol::ConfigReport m;
    m.status = protocol::Status::kOk;
    m.generation = store_.generation();
    m.kept = r.kept;
    m.new_count = r.fresh.count;
    m.unknown_count = r.unknown.count;
    for (uint8_t i = 0; i < sizeof(r.fresh.id); ++i) {
      m.new_ids[i] = r.fresh.id[i];
      m.unknown_ids[i] = r.unknown.id[i];
    }
    return answer.send(m);
  }

  Controller& controller_;
  Session& session_;
  ConfigStore& store_;
  Timing timing_ = {};
};

}  // namespace thigmo

#endif  // THIGMO_CORE_COMMANDS_H_
