model BlockDiagram "Example 1 of Casella, Donida, Lovera: a lag, a gain, a sine, and a gain that takes the first one back"
  connector RealInput = input Real;
  connector RealOutput = output Real;

  block FirstOrder "y/u = k/(1 + T s)"
    parameter Real k = 1;
    parameter Real T(unit="s") = 1;
    RealInput u;
    RealOutput y(start=0);
  equation
    T*der(y) + y = k*u;
  end FirstOrder;

  block Gain
    parameter Real k = 1;
    RealInput u;
    RealOutput y;
  equation
    y = k*u;
  end Gain;

  block Sine
    RealInput u;
    RealOutput y;
  equation
    y = sin(u);
  end Sine;

  parameter Real p1(unit="s", min=1, max=3) = 2 "time constant";
  parameter Real p2(min=3, max=5) = 4 "gain";
  FirstOrder G(k=4, T=p1);
  Gain before(k=p2);
  Sine sine;
  Gain behind(k=1/p2);
  RealInput u;
  RealOutput y;
equation
  connect(u, G.u);
  connect(G.y, before.u);
  connect(before.y, sine.u);
  connect(sine.y, behind.u);
  connect(behind.y, y);
end BlockDiagram;
