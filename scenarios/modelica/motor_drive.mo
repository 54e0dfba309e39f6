model MotorDrive "DC motor behind a voltage limit, gearbox, flexible shaft, and a load of uncertain inertia with friction"
  connector RealInput = input Real;
  connector RealOutput = output Real;

  connector Pin
    Real v(unit="V");
    flow Real i(unit="A");
  end Pin;

  connector Flange
    Real phi(unit="rad");
    flow Real tau(unit="N.m");
  end Flange;

  block Limiter
    parameter Real most(unit="V") = 1;
    RealInput u(unit="V");
    RealOutput y(unit="V");
  equation
    y = max(-most, min(most, u));
  end Limiter;

  model Source "A voltage that a signal gives"
    RealInput u(unit="V");
    Pin p;
    Pin n;
  equation
    p.v - n.v = u;
    p.i + n.i = 0;
  end Source;

  model Ground
    Pin p;
  equation
    p.v = 0;
  end Ground;

  partial model TwoPin
    Pin p;
    Pin n;
    Real v(unit="V");
    Real i(unit="A");
  equation
    v = p.v - n.v;
    i = p.i;
    p.i + n.i = 0;
  end TwoPin;

  model Resistor
    extends TwoPin;
    parameter Real R(unit="Ohm") = 1;
  equation
    v = R*i;
  end Resistor;

  model Inductor
    extends TwoPin(i(start=0));
    parameter Real L(unit="H") = 1;
  equation
    v = L*der(i);
  end Inductor;

  model Converter "Torque of the current, voltage of the speed"
    extends TwoPin;
    parameter Real k(unit="N.m/A") = 1;
    Flange flange;
    Real w(unit="rad/s");
  equation
    w = der(flange.phi);
    v = k*w;
    flange.tau = -k*i;
  end Converter;

  model Inertia
    parameter Real J(unit="kg.m2") = 1;
    Flange a;
    Flange b;
    Real phi(unit="rad", start=0);
    Real w(unit="rad/s", start=0);
  equation
    phi = a.phi;
    phi = b.phi;
    w = der(phi);
    J*der(w) = a.tau + b.tau;
  end Inertia;

  model Gear "a turns ratio times as fast as b"
    parameter Real ratio = 1;
    Flange a;
    Flange b;
  equation
    a.phi = ratio*b.phi;
    0 = ratio*a.tau + b.tau;
  end Gear;

  model Shaft
    parameter Real c(unit="N.m/rad") = 1;
    parameter Real d(unit="N.m.s/rad") = 0;
    Flange a;
    Flange b;
    Real phi_rel(unit="rad", start=0);
    Real w_rel(unit="rad/s");
  equation
    phi_rel = b.phi - a.phi;
    w_rel = der(phi_rel);
    b.tau = c*phi_rel + d*w_rel;
    a.tau + b.tau = 0;
  end Shaft;

  model Friction "Coulomb friction that a smooth function stands for, and viscous friction"
    parameter Real tau_c(unit="N.m") = 0;
    parameter Real w_0(unit="rad/s") = 1;
    parameter Real d(unit="N.m.s/rad") = 0;
    Flange a;
    Real w(unit="rad/s");
  equation
    w = der(a.phi);
    a.tau = tau_c*tanh(w/w_0) + d*w;
  end Friction;

  parameter Real J_load(unit="kg.m2", min=0.05, max=0.15) = 0.1 "inertia of the load";
  parameter Real R(unit="Ohm", min=0.4, max=0.8) = 0.5 "resistance, cold to hot";
  parameter Real c(unit="N.m/rad", min=40, max=90) = 60 "stiffness of the shaft";
  Limiter limiter(most=24);
  Source source;
  Ground ground;
  Resistor resistor(R=R);
  Inductor inductor(L=1.5e-3);
  Converter emf(k=0.05);
  Inertia rotor(J=2e-4);
  Gear gear(ratio=20);
  Shaft shaft(c=c, d=0.05);
  Inertia load(J=J_load);
  Friction friction(tau_c=0.3, w_0=0.5, d=0.02);
  RealInput u(unit="V", start=0);
  output Real speed(unit="rad/s") = load.w;
  output Real current(unit="A") = inductor.i;
equation
  connect(u, limiter.u);
  connect(limiter.y, source.u);
  connect(source.p, resistor.p);
  connect(resistor.n, inductor.p);
  connect(inductor.n, emf.p);
  connect(emf.n, source.n);
  connect(source.n, ground.p);
  connect(emf.flange, rotor.a);
  connect(rotor.b, gear.a);
  connect(gear.b, shaft.a);
  connect(shaft.b, load.a);
  connect(load.b, friction.a);
end MotorDrive;
