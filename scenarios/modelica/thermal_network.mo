model ThermalNetwork "An electronics box: board, wall, air gap, and radiation to cold surroundings"
  connector RealInput = input Real;

  connector Port
    Real T(unit="K");
    flow Real Q(unit="W");
  end Port;

  model Capacity
    parameter Real C(unit="J/K") = 1;
    Port port;
    Real T(unit="K", start=300, nominal=300);
  equation
    T = port.T;
    C*der(T) = port.Q;
  end Capacity;

  model Conductor
    parameter Real G(unit="W/K") = 1;
    Port a;
    Port b;
  equation
    a.Q = G*(a.T - b.T);
    a.Q + b.Q = 0;
  end Conductor;

  model Radiation "Stefan and Boltzmann"
    parameter Real Gr(unit="m2") = 1 "emissivity times area";
    constant Real sigma(unit="W/(m2.K4)") = 5.670374419e-8;
    Port a;
    Port b;
  equation
    a.Q = Gr*sigma*(a.T^4 - b.T^4);
    a.Q + b.Q = 0;
  end Radiation;

  model Heater
    RealInput Q(unit="W");
    Port port;
  equation
    port.Q = -Q;
  end Heater;

  model Surroundings
    RealInput T(unit="K");
    Port port;
  equation
    port.T = T;
  end Surroundings;

  parameter Real C_board(unit="J/K", min=150, max=300) = 200;
  parameter Real G_gap(unit="W/K", min=0.5, max=2) = 1 "conductance of the air gap, by its filling";
  parameter Real area(unit="m2", min=0.1, max=0.3) = 0.2 "radiating area times its emissivity";
  Heater heater;
  Capacity board(C=C_board);
  Conductor mount(G=3);
  Conductor gap(G=G_gap);
  Capacity wall(C=900, T(start=290));
  Radiation radiation(Gr=area);
  Surroundings surroundings;
  RealInput Q(unit="W", start=40);
  RealInput T_outside(unit="K", start=253.15);
  output Real T_board(unit="K") = board.T;
  output Real T_wall(unit="K") = wall.T;
equation
  connect(Q, heater.Q);
  connect(heater.port, board.port);
  connect(board.port, mount.a);
  connect(mount.b, wall.port);
  connect(board.port, gap.a);
  connect(gap.b, wall.port);
  connect(wall.port, radiation.a);
  connect(radiation.b, surroundings.port);
  connect(T_outside, surroundings.T);
end ThermalNetwork;
