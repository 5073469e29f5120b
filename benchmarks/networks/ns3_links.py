"""Links recorded in an independent simulator, ns-3: a vehicle's Wi-Fi at two distances, and LTE along a road.

A UDP message of 200 bytes leaves every 20 ms. The table lists the time of each message and its delay or loss. The same
version and seed reproduce the files byte for byte.

    python -m venv ns3 && ns3/bin/pip install ns3==3.44.post0
    ns3/bin/python benchmarks/networks/ns3_links.py            # all, into examples/networks/
    ns3/bin/python benchmarks/networks/ns3_links.py wifi-far --seconds 600 --out /tmp

ns-3 is GPL-2.0 software; this script calls it unmodified, and its output is ours.
"""

import argparse
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

OUT = Path(__file__).resolve().parents[2] / "examples" / "networks"
INTERVAL = 20
"""Time between two messages [ms]."""
SIZE = 200
"""Size of a message [bytes]."""
START = 2.0
"""Time of the first message [s], after the stations have associated."""

_MASTS = 5
"""Number of base stations: a road of 2 km, two minutes at 15 m/s."""

_SINK = """
#include "ns3/seq-ts-header.h"
#include <utility>
#include <vector>
std::vector<std::pair<uint32_t, double>> outrider_arrived;
void outrider_arrives(ns3::Ptr<const ns3::Packet> packet) {
  ns3::Ptr<ns3::Packet> copy = packet->Copy();
  ns3::SeqTsHeader header;
  copy->RemoveHeader(header);
  double took = (ns3::Simulator::Now() - header.GetTs()).GetSeconds();
  outrider_arrived.push_back({header.GetSeq(), took});
}
void outrider_listen(ns3::Ptr<ns3::Application> server) {
  server->TraceConnectWithoutContext("Rx", ns3::MakeCallback(&outrider_arrives));
}
"""


def send_beside(ns: Any, node: Any, to: Any, rate: str) -> None:
    """Send background packets of 1,400 bytes at this rate, with on and off times of 0.5 s on average."""
    other = ns.OnOffHelper("ns3::UdpSocketFactory", to)
    other.SetAttribute("DataRate", ns.DataRateValue(ns.DataRate(rate)))
    other.SetAttribute("PacketSize", ns.UintegerValue(1400))
    for time in ("OnTime", "OffTime"):
        other.SetAttribute(time, ns.StringValue("ns3::ExponentialRandomVariable[Mean=0.5]"))
    other.Install(node).Start(ns.Seconds(1.0))


def wifi(ns: Any, distance: float, stations: int) -> tuple[Any, ...]:
    """Create an 802.11g ad hoc network with Nakagami fading and background stations.

    Fading has m = 1.5, 1, 0.75 by distance. Path loss is log-distance with the exponent 3 and ns-3's 46.7 dB at 1 m; 16
    dBm; Minstrel selects the rate. Each background station sends 1,400 bytes at random times, 1 Mbit/s on average.
    """
    nodes = ns.NodeContainer()
    nodes.Create(2 + 2 * stations)
    channel = ns.YansWifiChannelHelper()
    channel.SetPropagationDelay("ns3::ConstantSpeedPropagationDelayModel")
    channel.AddPropagationLoss(
        "ns3::LogDistancePropagationLossModel", "Exponent", ns.DoubleValue(3.0)
    )
    channel.AddPropagationLoss("ns3::NakagamiPropagationLossModel")
    phy = ns.YansWifiPhyHelper()
    phy.SetChannel(channel.Create())
    station = ns.WifiHelper()
    station.SetStandard(ns.WIFI_STANDARD_80211g)
    station.SetRemoteStationManager("ns3::MinstrelWifiManager")
    mac = ns.WifiMacHelper()
    mac.SetType("ns3::AdhocWifiMac")
    devices = station.Install(phy, mac, nodes)
    positions = ns.CreateObject[ns.ListPositionAllocator]()
    positions.Add(ns.Vector(0.0, 0.0, 0.0))
    positions.Add(ns.Vector(distance, 0.0, 0.0))
    for k in range(2 * stations):
        positions.Add(ns.Vector(0.5 * distance, 5.0 + 5.0 * k, 0.0))
    mobility = ns.MobilityHelper()
    mobility.SetPositionAllocator(positions)
    mobility.SetMobilityModel("ns3::ConstantPositionMobilityModel")
    mobility.Install(nodes)
    ns.InternetStackHelper().Install(nodes)
    addresses = ns.Ipv4AddressHelper()
    addresses.SetBase(ns.Ipv4Address("10.0.0.0"), ns.Ipv4Mask("255.255.255.0"))
    given = addresses.Assign(devices)
    ns.NeighborCacheHelper().PopulateNeighborCache()  # no address resolution during the run
    for k in range(stations):
        to = ns.InetSocketAddress(given.GetAddress(3 + 2 * k), 10).ConvertTo()
        send_beside(ns, nodes.Get(2 + 2 * k), to, "2Mb/s")
    return nodes.Get(0), nodes.Get(1), given.GetAddress(1), station, phy, mac


def lte(ns: Any, speed: float, gap: float, parked: int) -> tuple[Any, ...]:
    """Create a 4G uplink along a road: base stations every `gap` m, 46 dBm, handover by signal strength (A3).

    Path loss is log-distance with the exponent 3; 25 resource blocks, proportional fair, acknowledged radio bearer. The
    core network adds 10 ms. Other stations in each cell send 3 Mbit/s each on average.
    """
    ns.Config.SetDefault("ns3::LteEnbPhy::TxPower", ns.DoubleValue(46.0))
    ns.Config.SetDefault("ns3::LteUePhy::TxPower", ns.DoubleValue(23.0))
    helper, core = ns.CreateObject[ns.LteHelper](), ns.CreateObject[ns.PointToPointEpcHelper]()
    helper.SetEpcHelper(core)
    helper.SetSchedulerType("ns3::PfFfMacScheduler")
    helper.SetHandoverAlgorithmType("ns3::A3RsrpHandoverAlgorithm")
    helper.SetPathlossModelType(ns.TypeId.LookupByName("ns3::LogDistancePropagationLossModel"))
    helper.SetPathlossModelAttribute("Exponent", ns.DoubleValue(3.0))
    receiver, vehicle, masts = ns.NodeContainer(), ns.NodeContainer(), ns.NodeContainer()
    receiver.Create(1)
    vehicle.Create(1 + parked * _MASTS)
    masts.Create(_MASTS)
    stack = ns.InternetStackHelper()
    stack.Install(receiver)
    wire = ns.PointToPointHelper()
    wire.SetDeviceAttribute("DataRate", ns.DataRateValue(ns.DataRate("1Gb/s")))
    wire.SetChannelAttribute("Delay", ns.TimeValue(ns.MilliSeconds(10)))
    addresses = ns.Ipv4AddressHelper()
    addresses.SetBase(ns.Ipv4Address("1.0.0.0"), ns.Ipv4Mask("255.0.0.0"))
    given = addresses.Assign(wire.Install(core.GetPgwNode(), receiver.Get(0)))
    routes = ns.Ipv4StaticRoutingHelper()
    routes.GetStaticRouting(receiver.Get(0).GetObject[ns.Ipv4]()).AddNetworkRouteTo(
        ns.Ipv4Address("7.0.0.0"), ns.Ipv4Mask("255.0.0.0"), 1
    )
    positions = ns.CreateObject[ns.ListPositionAllocator]()
    for k in range(masts.GetN()):
        positions.Add(ns.Vector(gap * k, 100.0, 30.0))
    standing, driving = ns.MobilityHelper(), ns.MobilityHelper()
    standing.SetPositionAllocator(positions)
    standing.SetMobilityModel("ns3::ConstantPositionMobilityModel")
    standing.Install(masts)
    driving.SetMobilityModel("ns3::ConstantVelocityMobilityModel")
    driving.Install(vehicle)
    for k in range(parked * _MASTS):
        position = ns.Vector(gap * (k // parked) + 40.0 * (k % parked) - 80.0, 20.0, 1.5)
        vehicle.Get(1 + k).GetObject[ns.ConstantVelocityMobilityModel]().SetPosition(position)
    mobility = vehicle.Get(0).GetObject[ns.ConstantVelocityMobilityModel]()
    mobility.SetPosition(ns.Vector(0.0, 0.0, 1.5))
    mobility.SetVelocity(ns.Vector(speed, 0.0, 0.0))
    helper.InstallEnbDevice(masts)
    modem = helper.InstallUeDevice(vehicle)
    stack.Install(vehicle)
    core.AssignUeIpv4Address(modem)
    for k in range(vehicle.GetN()):
        routes.GetStaticRouting(vehicle.Get(k).GetObject[ns.Ipv4]()).SetDefaultRoute(
            core.GetUeDefaultGatewayAddress(), 1
        )
    helper.Attach(modem)
    to = ns.InetSocketAddress(given.GetAddress(1), 10).ConvertTo()
    for k in range(1, vehicle.GetN()):
        send_beside(ns, vehicle.Get(k), to, "6Mb/s")
    helper.AddX2Interface(masts)
    return vehicle.Get(0), receiver.Get(0), given.GetAddress(1), helper, core


CASES: dict[str, Callable[[Any], tuple[Any, ...]]] = {
    "wifi-near": lambda ns: wifi(ns, 20.0, 1),
    "wifi-far": lambda ns: wifi(ns, 45.0, 2),
    "lte-road": lambda ns: lte(ns, 15.0, 500.0, 1),
}
"""Cases: functions that return sender, receiver, the receiver's address, and objects to keep alive."""


def record(case: str, seconds: float) -> str:
    """Simulate one case and return its table."""
    from ns import ns  # noqa: PLC0415 - loads all of ns-3

    ns.cppyy.cppdef(_SINK)
    ns.RngSeedManager.SetSeed(1)
    ns.RngSeedManager.SetRun(1)
    sender, receiver, address, *_kept = CASES[case](ns)
    server = ns.UdpServerHelper(9).Install(receiver)
    ns.cppyy.gbl.outrider_listen(server.Get(0))
    client = ns.UdpClientHelper(ns.InetSocketAddress(address, 9).ConvertTo())
    count = round(1000.0 * seconds / INTERVAL)
    for name, value in (
        ("MaxPackets", ns.UintegerValue(count)),
        ("PacketSize", ns.UintegerValue(SIZE)),
        ("Interval", ns.TimeValue(ns.MilliSeconds(INTERVAL))),
    ):
        client.SetAttribute(name, value)
    client.Install(sender).Start(ns.Seconds(START))
    ns.Simulator.Stop(ns.Seconds(START + seconds + 5.0))
    ns.Simulator.Run()
    took = {int(pair.first): float(pair.second) for pair in ns.cppyy.gbl.outrider_arrived}
    rows = [
        f"{0.001 * INTERVAL * k:.2f},{f'{took[k]:.5f}' if k in took else 'lost'}"
        for k in range(count)
    ]
    head = f"# ns-3 3.44, seed 1: benchmarks/networks/ns3_links.py {case} --seconds {seconds:g}"
    return "\n".join([head, "sent [s],delay [s]", *rows]) + "\n"


def main() -> None:
    """Write the tables; each case needs its own process, because ns-3 has one world per process."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", nargs="?", choices=CASES, help="Case to record; default: all.")
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    if options.case is None:
        for case in CASES:
            given = ["--seconds", f"{options.seconds:g}", "--out", str(options.out)]
            subprocess.run([sys.executable, __file__, case, *given], check=True)
        return
    options.out.mkdir(parents=True, exist_ok=True)
    text = record(options.case, options.seconds)
    (options.out / f"{options.case}.csv").write_text(text, encoding="utf-8")
    lost = text.count(",lost")
    sys.stdout.write(f"{options.out / options.case}.csv: {lost} messages lost\n")


if __name__ == "__main__":
    main()
