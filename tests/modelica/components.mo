package Components "A small library of components, written from the physics, and models made of them"

  package Interfaces
    connector RealInput = input Real;
    connector RealOutput = output Real;
    connector Rotating
      Real phi(unit="rad");
      flow Real tau(unit="N.m");
    end Rotating;
    connector Sliding
      Real s(unit="m");
      flow Real f(unit="N");
    end Sliding;
    connector Pin
      Real v(unit="V");
      flow Real i(unit="A");
    end Pin;
    connector HeatPort
      Real T(unit="K");
      flow Real Q(unit="W");
    end HeatPort;
    connector Frame "of a plane: position, angle, forces in the axes of the ground, torque"
      Real r[2](each unit="m");
      Real phi(unit="rad");
      flow Real f[2](each unit="N");
      flow Real t(unit="N.m");
    end Frame;
  end Interfaces;

  package Sources
    import Components.Interfaces.*;
    block Sine "a sine of time: it becomes an input"
      parameter Real amplitude = 1;
      parameter Real frequency(unit="1/s") = 1;
      parameter Real offset = 0;
      parameter Real begin(unit="s") = 0;
      RealOutput y;
    protected
      constant Real pi = 2*asin(1.0);
    equation
      y = offset + (if time < begin then 0 else amplitude*sin(2*pi*frequency*(time - begin)));
    end Sine;
    block Ramp
      parameter Real height = 1;
      parameter Real duration(unit="s") = 1;
      parameter Real begin(unit="s") = 0;
      RealOutput y;
    equation
      y = if time < begin then 0 elseif time < begin + duration then height*(time - begin)/duration
        else height;
    end Ramp;
    block Step
      parameter Real height = 1;
      parameter Real begin(unit="s") = 0;
      RealOutput y;
    equation
      y = if time < begin then 0 else height;
    end Step;
  end Sources;

  package Rotational
    import Components.Interfaces.*;
    partial model Compliant
      Rotating a;
      Rotating b;
      Real phi_rel(unit="rad", start=0);
      Real tau(unit="N.m");
    equation
      phi_rel = b.phi - a.phi;
      b.tau = tau;
      a.tau = -tau;
    end Compliant;
    model Spring
      extends Compliant;
      parameter Real c(unit="N.m/rad") = 1;
    equation
      tau = c*phi_rel;
    end Spring;
    model Damper
      extends Compliant;
      parameter Real d(unit="N.m.s/rad") = 1;
      Real w_rel(unit="rad/s");
    equation
      w_rel = der(phi_rel);
      tau = d*w_rel;
    end Damper;
    model Inertia
      parameter Real J(unit="kg.m2") = 1;
      Rotating a;
      Rotating b;
      Real phi(unit="rad", start=0);
      Real w(unit="rad/s", start=0);
      Real z(unit="rad/s2");
    equation
      phi = a.phi;
      phi = b.phi;
      w = der(phi);
      z = der(w);
      J*z = a.tau + b.tau;
    end Inertia;
    model Gear
      parameter Real ratio = 1;
      Rotating a;
      Rotating b;
      Rotating housing;
    equation
      a.phi - housing.phi = ratio*(b.phi - housing.phi);
      0 = ratio*a.tau + b.tau;
      0 = a.tau + b.tau + housing.tau;
    end Gear;
    model Fixed
      Rotating flange;
    equation
      flange.phi = 0;
    end Fixed;
    model Torque "between a shaft and its housing"
      RealInput tau;
      Rotating flange;
      Rotating housing;
    equation
      flange.tau = -tau;
      housing.tau = tau;
    end Torque;
    model QuadraticLoad "a torque that grows with the square of the speed"
      parameter Real tau_nominal(unit="N.m") = 1;
      parameter Real w_nominal(unit="rad/s") = 1;
      Rotating flange;
      Real w(unit="rad/s");
    equation
      w = der(flange.phi);
      flange.tau = tau_nominal*(if w >= 0 then (w/w_nominal)^2 else -(w/w_nominal)^2);
    end QuadraticLoad;
  end Rotational;

  package Translational
    import Components.Interfaces.*;
    model Mass
      parameter Real m(unit="kg") = 1;
      parameter Real L(unit="m") = 0 "length";
      Sliding a;
      Sliding b;
      Real s(unit="m", start=0);
      Real v(unit="m/s", start=0);
      Real acceleration(unit="m/s2");
    equation
      a.s = s - L/2;
      b.s = s + L/2;
      v = der(s);
      acceleration = der(v);
      m*acceleration = a.f + b.f;
    end Mass;
    model Spring
      parameter Real c(unit="N/m") = 1;
      parameter Real s_0(unit="m") = 0;
      Sliding a;
      Sliding b;
    equation
      b.f = c*(b.s - a.s - s_0);
      a.f + b.f = 0;
    end Spring;
    model SpringDamper
      parameter Real c(unit="N/m") = 1;
      parameter Real d(unit="N.s/m") = 1;
      parameter Real s_0(unit="m") = 0;
      Sliding a;
      Sliding b;
      Real s_rel(unit="m");
      Real v_rel(unit="m/s");
    equation
      s_rel = b.s - a.s;
      v_rel = der(s_rel);
      b.f = c*(s_rel - s_0) + d*v_rel;
      a.f + b.f = 0;
    end SpringDamper;
    model Fixed
      parameter Real s_0(unit="m") = 0;
      Sliding flange;
    equation
      flange.s = s_0;
    end Fixed;
    model Force
      RealInput f;
      Sliding flange;
    equation
      flange.f = -f;
    end Force;
    model Accelerate "the acceleration of a flange is given"
      RealInput a_ref;
      Sliding flange;
      Real v(unit="m/s", start=0);
      Real s(unit="m", start=0);
    equation
      s = flange.s;
      v = der(s);
      der(v) = a_ref;
    end Accelerate;
  end Translational;

  package Electrical
    import Components.Interfaces.*;
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
    model Ground
      Pin p;
    equation
      p.v = 0;
    end Ground;
    model Resistor
      extends TwoPin;
      parameter Real R(unit="Ohm") = 1;
    equation
      v = R*i;
    end Resistor;
    model Conductor
      extends TwoPin;
      parameter Real G(unit="S") = 1;
    equation
      i = G*v;
    end Conductor;
    model Capacitor
      extends TwoPin(v(start=0));
      parameter Real C(unit="F") = 1;
    equation
      i = C*der(v);
    end Capacitor;
    model Inductor
      extends TwoPin(i(start=0));
      parameter Real L(unit="H") = 1;
    equation
      v = L*der(i);
    end Inductor;
    model Source
      extends TwoPin;
      RealInput u;
    equation
      v = u;
    end Source;
    model PiecewiseLinear "three pieces, odd"
      extends TwoPin;
      parameter Real G_inner(unit="S") = -1;
      parameter Real G_outer(unit="S") = -0.5;
      parameter Real v_bend(unit="V") = 1;
    equation
      i = if v < -v_bend then G_outer*(v + v_bend) - G_inner*v_bend
        elseif v > v_bend then G_outer*(v - v_bend) + G_inner*v_bend
        else G_inner*v;
    end PiecewiseLinear;
    model Converter "torque of the current, voltage of the speed"
      extends TwoPin;
      parameter Real k(unit="N.m/A") = 1;
      Rotating flange;
      Real w(unit="rad/s");
    equation
      w = der(flange.phi);
      v = k*w;
      flange.tau = -k*i;
    end Converter;
    model Machine "permanently excited DC machine"
      parameter Real R(unit="Ohm") = 0.05;
      parameter Real L(unit="H") = 1.5e-3;
      parameter Real k(unit="N.m/A") = 1;
      parameter Real J(unit="kg.m2") = 0.15;
      Pin p;
      Pin n;
      Rotating flange;
      Resistor resistance(R=R);
      Inductor inductance(L=L);
      Converter emf(k=k);
      Rotational.Inertia rotor(J=J);
    equation
      connect(p, resistance.p);
      connect(resistance.n, inductance.p);
      connect(inductance.n, emf.p);
      connect(emf.n, n);
      connect(emf.flange, rotor.a);
      connect(rotor.b, flange);
    end Machine;
  end Electrical;

  package Thermal
    import Components.Interfaces.*;
    model Capacity
      parameter Real C(unit="J/K") = 1;
      HeatPort port;
      Real T(unit="K", start=300);
    equation
      T = port.T;
      C*der(T) = port.Q;
    end Capacity;
    model Conductor
      parameter Real G(unit="W/K") = 1;
      HeatPort a;
      HeatPort b;
    equation
      a.Q = G*(a.T - b.T);
      a.Q + b.Q = 0;
    end Conductor;
    model Heater
      RealInput Q;
      HeatPort port;
    equation
      port.Q = -Q;
    end Heater;
  end Thermal;

  package Planar "bodies in a vertical plane"
    import Components.Interfaces.*;
    model World
      Frame frame;
    equation
      frame.r = {0.0, 0.0};
      frame.phi = 0;
    end World;
    model Revolute
      parameter Real d(unit="N.m.s/rad") = 0;
      Frame a;
      Frame b;
      RealInput tau;
      Real phi(unit="rad", start=0, stateSelect=StateSelect.prefer);
      Real w(unit="rad/s", start=0, stateSelect=StateSelect.prefer);
      Real z(unit="rad/s2");
    equation
      a.r = b.r;
      b.phi = a.phi + phi;
      w = der(phi);
      z = der(w);
      a.f + b.f = {0.0, 0.0};
      a.t + b.t = 0;
      b.t = d*w - tau;
    end Revolute;
    model Bar "a rigid connection, along the axis x of frame a"
      parameter Real L(unit="m") = 1;
      Frame a;
      Frame b;
    equation
      b.r[1] = a.r[1] + L*cos(a.phi);
      b.r[2] = a.r[2] + L*sin(a.phi);
      b.phi = a.phi;
      a.f + b.f = {0.0, 0.0};
      a.t + b.t + L*(cos(a.phi)*b.f[2] - sin(a.phi)*b.f[1]) = 0;
    end Bar;
    model Body
      parameter Real m(unit="kg") = 1;
      parameter Real J(unit="kg.m2") = 0;
      parameter Real g(unit="m/s2") = 9.81;
      Frame a;
      Real v[2](each unit="m/s");
      Real w(unit="rad/s");
    equation
      v = der(a.r);
      w = der(a.phi);
      a.f[1] = m*der(v[1]);
      a.f[2] = m*der(v[2]) + m*g;
      a.t = J*der(w);
    end Body;
  end Planar;

  package Examples
    import Components.Interfaces.*;
    model First "a sine drives two inertias over a gear and a spring"
      parameter Real J_3(unit="kg.m2", min=1, max=3) = 2;
      Sources.Sine sine(amplitude=10, frequency=5);
      Rotational.Fixed fixed;
      Rotational.Torque torque;
      Rotational.Inertia inertia1(J=1);
      Rotational.Gear gear(ratio=10);
      Rotational.Inertia inertia2(J=2);
      Rotational.Spring spring(c=10000);
      Rotational.Inertia inertia3(J=J_3);
      Rotational.Damper damper(d=10);
      output Real w(unit="rad/s") = inertia3.w;
    equation
      connect(sine.y, torque.tau);
      connect(torque.flange, inertia1.a);
      connect(torque.housing, fixed.flange);
      connect(inertia1.b, gear.a);
      connect(gear.b, inertia2.a);
      connect(gear.housing, fixed.flange);
      connect(inertia2.b, spring.a);
      connect(spring.b, inertia3.a);
      connect(damper.a, inertia2.b);
      connect(damper.b, fixed.flange);
    end First;

    model Oscillator "two masses on springs, one with a damper, each under the same force"
      parameter Real m(unit="kg", min=0.8, max=1.2) = 1;
      Sources.Sine sine(frequency=15.9155);
      Translational.Mass mass1(m=m, L=1);
      Translational.Spring spring1(c=10000, s_0=1);
      Translational.Fixed fixed1(s_0=1);
      Translational.Force force1;
      Translational.Mass mass2(m=m, L=1);
      Translational.SpringDamper spring2(c=10000, d=10, s_0=1);
      Translational.Fixed fixed2(s_0=1);
      Translational.Force force2;
      output Real s1(unit="m") = mass1.s;
      output Real s2(unit="m") = mass2.s;
    equation
      connect(sine.y, force1.f);
      connect(sine.y, force2.f);
      connect(fixed1.flange, spring1.a);
      connect(spring1.b, mass1.a);
      connect(mass1.b, force1.flange);
      connect(fixed2.flange, spring2.a);
      connect(spring2.b, mass2.a);
      connect(mass2.b, force2.flange);
    end Oscillator;

    model Accelerate "a mass whose acceleration is given: its states are those of the source"
      parameter Real m(unit="kg", min=0.5, max=1.5) = 1;
      Sources.Step step(height=1);
      Translational.Accelerate accelerate;
      Translational.Mass mass(m=m, L=1);
      output Real s(unit="m") = mass.s;
      output Real f(unit="N") = mass.a.f;
    equation
      connect(step.y, accelerate.a_ref);
      connect(accelerate.flange, mass.a);
    end Accelerate;

    model CauerLowPass "an elliptic low pass of order five: three of its capacitors make a loop, twice"
      parameter Real l1(unit="H", min=1.2, max=1.4) = 1.304;
      parameter Real l2(unit="H", min=0.8, max=0.92) = 0.8586;
      parameter Real c1(unit="F", min=1.0, max=1.15) = 1.072;
      parameter Real c2(unit="F", min=0.4, max=0.5) = 0.45;
      parameter Real c3(unit="F", min=1.6, max=1.8) = 1.682;
      parameter Real c4(unit="F", min=0.9, max=1.1) = 0.987;
      parameter Real c5(unit="F", min=0.7, max=0.75) = 0.7262;
      Electrical.Ground ground;
      Sources.Step step;
      Electrical.Source source;
      Electrical.Resistor R1(R=1);
      Electrical.Capacitor C1(C=c1);
      Electrical.Capacitor C2(C=c2);
      Electrical.Inductor L1(L=l1);
      Electrical.Capacitor C3(C=c3);
      Electrical.Capacitor C4(C=c4);
      Electrical.Inductor L2(L=l2);
      Electrical.Capacitor C5(C=c5);
      Electrical.Resistor R2(R=1);
      output Real v(unit="V") = C5.v;
    equation
      connect(step.y, source.u);
      connect(source.p, R1.p);
      connect(source.n, ground.p);
      connect(R1.n, C1.p);
      connect(C1.n, ground.p);
      connect(R1.n, C2.p);
      connect(R1.n, L1.p);
      connect(C2.n, C3.p);
      connect(L1.n, C3.p);
      connect(C3.n, ground.p);
      connect(C3.p, C4.p);
      connect(C3.p, L2.p);
      connect(C4.n, C5.p);
      connect(L2.n, C5.p);
      connect(C5.n, ground.p);
      connect(C5.p, R2.p);
      connect(R2.n, ground.p);
    end CauerLowPass;

    model ChuaCircuit "an oscillator with one resistor that is not linear"
      parameter Real L(unit="H", min=16, max=20) = 18;
      parameter Real C1(unit="F", min=9, max=11) = 10;
      Electrical.Inductor inductor(L=L);
      Electrical.Resistor winding(R=12.5e-3);
      Electrical.Conductor coupling(G=0.565);
      Electrical.Capacitor capacitor1(C=C1, v(start=0));
      Electrical.Capacitor capacitor2(C=100);
      Electrical.PiecewiseLinear diode(G_inner=-0.757576, G_outer=-0.409091, v_bend=1);
      Electrical.Ground ground;
      output Real v(unit="V") = capacitor1.v;
    equation
      connect(inductor.p, capacitor2.p);
      connect(inductor.n, winding.p);
      connect(winding.n, ground.p);
      connect(capacitor2.n, ground.p);
      connect(capacitor2.p, coupling.p);
      connect(coupling.n, capacitor1.p);
      connect(capacitor1.n, ground.p);
      connect(capacitor1.p, diode.p);
      connect(diode.n, ground.p);
    end ChuaCircuit;

    model TwoMasses "two bodies exchange heat"
      parameter Real C1(unit="J/K", min=10, max=20) = 15;
      parameter Real C2(unit="J/K", min=10, max=20) = 15;
      parameter Real G(unit="W/K", min=8, max=12) = 10;
      Thermal.Capacity mass1(C=C1, T(start=373.15));
      Thermal.Capacity mass2(C=C2, T(start=273.15));
      Thermal.Conductor conductor(G=G);
      Thermal.Heater heater;
      RealInput Q(unit="W", start=0);
      output Real T1(unit="K") = mass1.T;
      output Real T2(unit="K") = mass2.T;
    equation
      connect(Q, heater.Q);
      connect(heater.port, mass1.port);
      connect(mass1.port, conductor.a);
      connect(conductor.b, mass2.port);
    end TwoMasses;

    model MachineStart "a DC machine runs up with a load that grows with the square of the speed"
      parameter Real J_load(unit="kg.m2", min=0.1, max=0.3) = 0.15;
      Sources.Ramp ramp(height=100, duration=0.8, begin=0.2);
      Electrical.Source source;
      Electrical.Ground ground;
      Electrical.Machine machine(R=0.05, L=1.5e-3, k=0.67, J=0.15);
      Rotational.Inertia load(J=J_load);
      Rotational.QuadraticLoad torque(tau_nominal=63.66, w_nominal=149.2);
      output Real w(unit="rad/s") = load.w;
      output Real i(unit="A") = machine.inductance.i;
    equation
      connect(ramp.y, source.u);
      connect(source.p, machine.p);
      connect(source.n, machine.n);
      connect(source.n, ground.p);
      connect(machine.flange, load.a);
      connect(load.b, torque.flange);
    end MachineStart;

    model Pendulum "a point mass on a bar on a hinge with a damper"
      parameter Real m(unit="kg", min=1.4, max=2.6) = 2;
      parameter Real L(unit="m", min=0.6, max=1.2) = 0.8;
      Planar.World world;
      Planar.Revolute hinge(d=0.05, phi(start=-1.5707963267948966));
      Planar.Bar bar(L=L);
      Planar.Body bob(m=m);
      RealInput tau(unit="N.m", start=0);
      output Real phi(unit="rad") = hinge.phi;
    equation
      connect(tau, hinge.tau);
      connect(world.frame, hinge.a);
      connect(hinge.b, bar.a);
      connect(bar.b, bob.a);
    end Pendulum;
  end Examples;
end Components;
