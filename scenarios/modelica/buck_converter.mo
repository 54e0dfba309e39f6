model BuckConverter "Averaged step-down converter with a load of constant power, which has a negative resistance"
  connector RealInput = input Real;

  connector Pin
    Real v(unit="V");
    flow Real i(unit="A");
  end Pin;

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

  model Switch "Switch and diode, averaged: the duty times the supply"
    extends TwoPin;
    RealInput duty;
    RealInput supply(unit="V");
  equation
    v = duty*supply;
  end Switch;

  model Resistor
    extends TwoPin;
    parameter Real R(unit="Ohm") = 1;
  equation
    v = R*i;
  end Resistor;

  model Inductor
    extends TwoPin(i(start=1));
    parameter Real L(unit="H") = 1;
  equation
    v = L*der(i);
  end Inductor;

  model Capacitor
    extends TwoPin(v(start=12));
    parameter Real C(unit="F") = 1;
  equation
    i = C*der(v);
  end Capacitor;

  model PowerLoad
    extends TwoPin;
    parameter Real P(unit="W") = 1;
  equation
    i = P/v;
  end PowerLoad;

  model Ground
    Pin p;
  equation
    p.v = 0;
  end Ground;

  parameter Real L(unit="H", min=7e-5, max=1.3e-4) = 1e-4;
  parameter Real C(unit="F", min=1.5e-4, max=2.5e-4) = 2e-4;
  parameter Real P(unit="W", min=5, max=15) = 10 "power of the load";
  Switch switch;
  Resistor winding(R=0.05);
  Inductor inductor(L=L);
  Resistor esr(R=0.02) "of the capacitor";
  Capacitor capacitor(C=C);
  Resistor load(R=8);
  PowerLoad power(P=P);
  Ground ground;
  RealInput duty(start=0.5);
  RealInput supply(unit="V", start=24);
  output Real voltage(unit="V") = load.v;
  output Real current(unit="A") = inductor.i;
equation
  connect(duty, switch.duty);
  connect(supply, switch.supply);
  connect(switch.p, winding.p);
  connect(winding.n, inductor.p);
  connect(inductor.n, esr.p);
  connect(esr.n, capacitor.p);
  connect(capacitor.n, ground.p);
  connect(inductor.n, load.p);
  connect(load.n, ground.p);
  connect(inductor.n, power.p);
  connect(power.n, ground.p);
  connect(switch.n, ground.p);
end BuckConverter;
